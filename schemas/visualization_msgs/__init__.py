"""ROS 2 package visualization_msgs: its interfaces are in msg, srv and action."""
