"""ROS 2 package std_srvs: its interfaces are in msg, srv and action."""
