"""Tests that run in the guest when systemd is its init: slow, and so not among the others."""
