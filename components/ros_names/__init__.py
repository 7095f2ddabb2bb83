"""Gives the topics and services of a robot their ROS names."""
