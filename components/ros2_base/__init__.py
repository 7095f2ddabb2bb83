"""Driver of a base behind ROS 2: one that takes `cmd_vel` and publishes `odom` over rmw_zenoh."""
