"""Computer vision without a bus: images, features, recognition, stereo, ranging, calibration."""
