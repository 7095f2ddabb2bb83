"""Drivers that replay recordings: MRCLAM data sets, CARMEN logs, ROS 1 and ROS 2 bags."""
