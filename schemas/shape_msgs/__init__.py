"""ROS 2 package shape_msgs: its interfaces are in msg, srv and action."""
