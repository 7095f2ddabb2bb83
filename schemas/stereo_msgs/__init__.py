"""ROS 2 package stereo_msgs: its interfaces are in msg, srv and action."""
