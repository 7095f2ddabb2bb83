"""ROS 2 package type_description_interfaces: its interfaces are in msg, srv and action."""
