"""A component whose port does not say what it carries."""

from cairn import Component, Out


class OddPort(Component):
    """Writes something."""

    something: Out  # type: ignore[type-arg]
