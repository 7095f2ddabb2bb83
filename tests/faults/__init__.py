"""Tests of Cairn's reactions to faults, each in real processes."""
