"""Motion control: drives the robot along plans and never into obstacles."""
