"""Tests of mapping and lifelong maps."""
