"""Cameras: their calibration."""
