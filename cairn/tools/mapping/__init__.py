"""Building maps from recordings: the command `cairn map build`."""
