"""A plugin whose module cannot be imported."""

from cairn import Component

raise RuntimeError("this module is broken on purpose")


class Broken(Component):
    """Is never defined."""
