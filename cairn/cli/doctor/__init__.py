"""`cairn doctor`: what this computer lacks for a robot to run on it, with the remedy for each."""
