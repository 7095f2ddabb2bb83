"""A simulated turtle that wanders in a pen."""
