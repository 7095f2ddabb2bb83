"""Messages of ROS 2 package rosgraph_msgs."""



from cairn.schemas.rosgraph_msgs import Clock as Clock
