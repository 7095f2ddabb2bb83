"""Evaluates navigation: random goals in a simulated world, and what came of them."""
