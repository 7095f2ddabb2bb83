"""Driver of a stereo camera behind ROS 2: one whose nodes publish images over rmw_zenoh."""
