"""Tests of the commands for maps."""
