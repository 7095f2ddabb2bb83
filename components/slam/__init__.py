"""SLAM: builds the grid map and the visual map of an unknown building while the robot drives."""
