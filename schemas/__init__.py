"""All messages on the bus, one module per ROS 2 package, and the machinery that defines them."""
