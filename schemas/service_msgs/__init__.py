"""ROS 2 package service_msgs: its interfaces are in msg, srv and action."""
