"""The vision framework's control component."""
