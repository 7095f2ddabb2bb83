"""AutoMove: executes missions with the plugins that it loads: the navigator state machine."""
