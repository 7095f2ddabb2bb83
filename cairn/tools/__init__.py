"""Commands that use components as a library: camera calibration, evaluation, experiments."""
