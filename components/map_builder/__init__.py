"""The map builder: keeps the visual map and the grid map up to date while the robot works."""
