"""Recordings (MCAP): taking them, reading them with limits, and the tools on them."""
