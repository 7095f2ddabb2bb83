"""What the tests of components share: a stage for one component, and lockstep runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cairn import SECOND, Component, Qos
from cairn.bus.bus import full_name
from cairn.bus.lockstep_bus import LockstepBus
from cairn.deployment.model import ChildSpec
from cairn.placement.lockstep import LockstepExecutor
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import Transition
from cairn.runtime.ports import ports_of
from cairn.runtime.runtime import Runtime

DATASET = Path(__file__).parents[1] / "data" / "mrclam" / "MRCLAM_Dataset6"
MANY = Qos("reliable", "transient_local", 100_000)


class Stage:
    """One component on virtual time: feed its inputs, let time pass, read its outputs."""

    def __init__(self, component: type[Component], start_s: float, **parameters: Any) -> None:
        self.executor = LockstepExecutor(round(start_s * SECOND))
        self.bus = LockstepBus()
        self.ends: list[ExitReport] = []
        self._ports = ports_of(component)
        self._outside = self.bus.node("/robot/outside", pytest.fail)
        self.runtime = Runtime(
            component,
            LaunchRequest(name="it", spec=ChildSpec(plugin="it", parameters=parameters)),
            self.bus,
            self.executor.scheduler(),
            self.executor,
            self.ends.append,
        )
        self._readers = {
            name: self._outside.subscribe(full_name("robot", name), spec.message, MANY, _nothing)
            for name, spec in self._ports.items()
            if spec.direction == "out"
        }
        self._writers = {
            name: self._outside.advertise(full_name("robot", name), spec.message, spec.qos)
            for name, spec in self._ports.items()
            if spec.direction == "in"
        }

    def begin(self) -> "Stage":
        self.runtime.transition(Transition.CONFIGURE)
        self.runtime.transition(Transition.ACTIVATE)
        return self

    def end(self) -> None:
        self.runtime.transition(Transition.DEACTIVATE)

    def give(self, port: str, message: Any) -> None:
        """Publish a message on an input port and let it be handled."""
        self._writers[port].publish(message)
        self.wait(0.0)

    def wait(self, seconds: float) -> None:
        """Let virtual time pass."""
        done: list[bool] = []
        self.executor.at(self.executor.now() + round(seconds * SECOND), lambda: done.append(True))
        self.executor.run(lambda: bool(done))

    def taken(self, port: str) -> list[Any]:
        """What the component has published on a port since the last call."""
        messages = []
        while (message := self._readers[port].take()) is not None:
            messages.append(message)
        return messages


def _nothing() -> None:
    pass


@pytest.fixture
def stage() -> Callable[..., Stage]:
    return Stage


@pytest.fixture(scope="session")
def dataset() -> Path:
    return DATASET
