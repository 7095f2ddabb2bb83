"""The navigation framework's control component."""
