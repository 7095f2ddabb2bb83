"""ROS 2 package nav2_msgs: its interfaces are in msg, srv and action."""
