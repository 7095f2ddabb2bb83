"""Range scanners that speak Hokuyo's SCIP: the driver, and the device emulated."""
