"""Judges a run against the truth: table, report and pictures."""
