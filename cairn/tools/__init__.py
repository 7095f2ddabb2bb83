"""Commands on navigation and vision: build and show maps, explore, calibrate cameras."""
