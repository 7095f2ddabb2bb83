"""ROS 2 package composition_interfaces: its interfaces are in msg, srv and action."""
