"""A plugin whose module can be imported by the check of a deployment, but not by components."""

from setproctitle import getproctitle

from cairn import Component

if getproctitle() != "cairn: check":
    raise RuntimeError("not in this environment")


class Moody(Component):
    """Passes every check but cannot start."""
