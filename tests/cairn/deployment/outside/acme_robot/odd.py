"""A component whose port does not say what it carries."""

from cairn.runtime.component import Component
from cairn.runtime.ports import Out


class OddPort(Component):
    """Writes something."""

    something: Out  # type: ignore[type-arg]
