"""Velocity gate: the one component that commands the base, for all sources of commands."""
