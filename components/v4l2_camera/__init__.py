"""Driver and probe of cameras and stereo cameras behind V4L2."""
