"""ROS 2 package trajectory_msgs: its interfaces are in msg, srv and action."""
