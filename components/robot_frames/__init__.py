"""Publishes the frames of a robot."""
