"""Hokuyo's PBS-03JN, an obstacle scanner: driver, emulator. Files: see `components`."""
