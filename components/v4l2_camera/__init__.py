"""Cameras and stereo cameras behind Linux's V4L2."""
