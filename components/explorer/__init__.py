"""Explorer: drives to the borders of what is mapped until nothing reachable is unknown."""
