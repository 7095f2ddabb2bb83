"""A plugin whose module can be imported by commands, but not where components run."""

import os

from cairn import Component

if "CAIRN_TREE" in os.environ:
    raise RuntimeError("not in this environment")


class Moody(Component):
    """Passes every check but cannot start."""
