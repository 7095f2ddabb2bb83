"""Component-based robot middleware over Zenoh: knows robots, knows nothing of navigation."""
