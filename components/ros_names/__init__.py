"""Gives the topics and services of a robot their names of ROS."""
