"""Motion control: drives the robot along plans, and never into what the scanner sees."""
