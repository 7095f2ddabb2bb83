"""A component whose port does not say what it carries."""

from cairn.component.component import Component
from cairn.component.ports import Out


class OddPort(Component):
    """Writes something."""

    something: Out  # type: ignore[type-arg]
