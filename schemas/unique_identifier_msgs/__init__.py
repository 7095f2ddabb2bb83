"""ROS 2 package unique_identifier_msgs: its interfaces are in msg, srv and action."""
