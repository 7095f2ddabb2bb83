"""One component on virtual time, without the rest: feed its inputs, let time pass, read it."""

from functools import partial
from typing import Any

from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.qos import Qos
from cairn.clock import SECOND
from cairn.placement.lockstep import LockstepExecutor
from cairn.runtime.component import Component
from cairn.runtime.lifecycle import Transition
from cairn.runtime.ports import ports_of
from cairn.runtime.runtime import Assignment, End, Runtime

ALL = Qos("reliable", "transient_local", 100_000)
"""So deep that a test finds everything that was sent."""


class Stage:
    """A component, active, whose ports are in the test's hands.

    `runtime` asks it and changes its parameters, `executor` has the time, `end` says how it ended,
    `order` has the output and the time [ns] of each message that it has published.
    """

    def __init__(self, component: type[Component], seed: int = 0, **parameters: Any) -> None:
        """Configure and activate it; raises `CairnError` if that fails."""
        self.end: End | None = None
        self.order: list[tuple[str, int]] = []
        self.executor = LockstepExecutor()
        bus = LockstepBus()
        self.runtime = Runtime(
            component,
            Assignment(name="it", plugin="it", parameters=parameters, seed=seed),
            bus,
            self.executor.scheduler(),
            self.executor,
            self._ended,
        )
        test = bus.node("/robot/test", self.runtime.log.error)
        ports = ports_of(component).values()
        self._writers = {
            port.name: test.advertise(f"/robot/{port.name}", port.message, port.qos)
            for port in ports
            if port.direction == "in"
        }
        self._readers = {
            port.name: test.subscribe(
                f"/robot/{port.name}", port.message, ALL, partial(self._note, port.name)
            )
            for port in ports
            if port.direction == "out"
        }
        self.runtime.transition(Transition.CONFIGURE)
        self.runtime.transition(Transition.ACTIVATE)

    def give(self, port: str, message: Any) -> None:
        """Send a message to an input and have it handled."""
        self._writers[port].publish(message)
        self.wait(0.0)

    def wait(self, seconds: float) -> None:
        """Let virtual time pass."""
        over: list[bool] = []
        self.executor.at(self.executor.now() + round(seconds * SECOND), lambda: over.append(True))
        self.executor.run(lambda: bool(over))

    def taken(self, port: str) -> list[Any]:
        """What it has published on an output since the last call."""
        messages = []
        while (message := self._readers[port].take()) is not None:
            messages.append(message)
        return messages

    def _note(self, port: str) -> None:
        self.order.append((port, self.executor.now()))

    def _ended(self, end: End) -> None:
        self.end = end
