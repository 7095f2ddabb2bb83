"""Explorer: drives the robot to the borders of what is mapped until nothing reachable is unknown."""
