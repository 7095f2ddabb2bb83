"""How long tests wait for an event that has to happen."""

LIMIT_S = 120.0
"""Far longer than anything takes, even on a busy machine; only a fault reaches it."""
