"""The localizer: where the robot is, and which objects of the map contradict it."""
