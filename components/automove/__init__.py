"""AutoMove: executes missions with the plugins that it loads: the mission state machine."""
