"""Driver of a range scanner behind ROS 2: one whose node publishes `scan` over rmw_zenoh."""
