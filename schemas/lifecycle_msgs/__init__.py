"""ROS 2 package lifecycle_msgs: its interfaces are in msg, srv and action."""
