"""A plugin whose module cannot be imported."""

from cairn.runtime.component import Component

raise RuntimeError("this module is broken on purpose")


class Broken(Component):
    """Never comes to be."""
