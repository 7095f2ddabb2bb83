"""What ROS 2 tools see of a robot: its description and frames, its ROS names and diagnostics."""
