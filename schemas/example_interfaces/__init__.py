"""ROS 2 package example_interfaces: its interfaces are in msg, srv and action."""
