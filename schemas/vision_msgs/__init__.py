"""ROS 2 package vision_msgs: its interfaces are in msg, srv and action."""
