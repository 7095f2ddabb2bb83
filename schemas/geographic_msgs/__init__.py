"""ROS 2 package geographic_msgs: its interfaces are in msg, srv and action."""
