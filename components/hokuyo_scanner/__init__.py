"""Range scanners that speak Hokuyo's SCIP: driver, emulator, probe. Files: see `components`."""
