"""ROS 2 package actionlib_msgs: its interfaces are in msg, srv and action."""
