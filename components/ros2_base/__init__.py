"""A base that speaks ROS 2: any that takes `cmd_vel` and tells `odom` over rmw_zenoh."""
