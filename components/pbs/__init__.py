"""Hokuyo's PBS-03JN, an obstacle scanner: the driver, and the device emulated."""
