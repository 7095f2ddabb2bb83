"""Tests of what Cairn does when something goes wrong, each in real processes."""
