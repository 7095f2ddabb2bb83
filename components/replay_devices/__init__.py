"""Replay of recordings: MRCLAM data sets, CARMEN logs, ROS bags, MCAP files, images, videos."""
