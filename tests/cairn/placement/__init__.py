"""Tests of where components run."""
