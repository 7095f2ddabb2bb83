"""A component whose port has no message type."""

from cairn import Component, Out


class OddPort(Component):
    """Publishes something."""

    something: Out  # type: ignore[type-arg]
