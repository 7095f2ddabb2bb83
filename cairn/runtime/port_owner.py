"""What the ports of a component need of its runtime."""

from collections.abc import Callable
from typing import Any, Protocol

from cairn.system.clock import Clock


class PortOwner(Protocol):
    """What the ports need of the component's runtime."""

    log: Any
    unlogged_clock: Clock
    """The component's time, read without a record in the call log."""

    @property
    def may_publish(self) -> bool:
        """Whether messages may be sent now."""
        ...

    def run(self, where: str, call: Callable[..., None], *arguments: Any) -> None:
        """Make one call into the component."""
        ...
