"""The localizer: estimates the robot's pose, and evidence for and against each landmark."""
