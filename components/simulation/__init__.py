"""A simulated world, and drivers of a robot in it: base, range scanner, object recognizer."""
