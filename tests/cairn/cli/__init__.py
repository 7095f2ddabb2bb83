"""Tests of the commands, against running deployments."""
