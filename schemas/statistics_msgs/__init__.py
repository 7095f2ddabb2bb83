"""ROS 2 package statistics_msgs: its interfaces are in msg, srv and action."""
