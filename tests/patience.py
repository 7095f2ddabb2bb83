"""How long tests wait for what ought to come."""

LIMIT_S = 120.0
"""Far longer than anything takes, even where others use the machine; reached only by a fault."""
