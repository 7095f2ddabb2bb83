"""Velocity gate: the one component that commands the base, whoever wants to drive the robot."""
