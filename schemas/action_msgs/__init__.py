"""ROS 2 package action_msgs: its interfaces are in msg, srv and action."""
