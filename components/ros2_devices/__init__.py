"""Drivers of devices behind ROS 2: a base, a range scanner and cameras of nodes over rmw_zenoh."""
