"""Keeps components running: restart policy, processes and the engine that drives both."""
