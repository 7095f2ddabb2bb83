"""Components for the tests, on threads of their own or in lockstep."""

import threading
from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any, Generic, TypeVar, cast

from cairn import LATCHED, RELIABLE, Component, Qos
from cairn.bus.bus import Bus, full_name
from cairn.bus.lockstep_bus import LockstepBus, LockstepSubscription
from cairn.clock import SystemClock
from cairn.deployment.model import ChildSpec
from cairn.placement.lockstep import LockstepExecutor
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.loop import ThreadLoop
from cairn.runtime.runtime import Runtime
from tests.patience import LIMIT_S

C = TypeVar("C", bound=Component)


def launch_request(
    *,
    name: str = "part",
    plugin: str = "test",
    parameters: dict[str, Any] | None = None,
    topics: dict[str, str] | None = None,
    parent: str = "",
    restarts: int = 0,
    **context: Any,
) -> LaunchRequest:
    """The request to start a component of a test; `context` are fields of `RunContext`."""
    return LaunchRequest(
        name=name,
        spec=ChildSpec(plugin=plugin, parameters=parameters or {}, topics=topics or {}),
        parent=parent,
        incarnation=1 + restarts,
        context=RunContext(**context),
    )


class Threaded:
    """A component on a thread of its own."""

    def __init__(self, component: type[Component], bus: Bus, /, **launch: Any) -> None:
        self.loop = ThreadLoop()
        self.ended = threading.Event()
        self.end: ExitReport | None = None
        request = launch_request(**launch)
        self.runtime = Runtime(component, request, bus, self.loop, SystemClock(), self._note)
        self.thread = threading.Thread(target=self.loop.run)
        self.thread.start()

    def ask(self, verb: str, arguments: Mapping[str, Any] | None = None) -> Any:
        """Return the reply to a control request."""
        answer: Future[Any] = Future()

        def make() -> None:
            try:
                answer.set_result(self.runtime.request(verb, arguments or {}))
            except Exception as error:
                answer.set_exception(error)

        self.loop.post(make)
        return answer.result(LIMIT_S)

    def activate(self) -> None:
        """Configure and activate."""
        self.ask("configure")
        self.ask("activate")

    def close(self) -> None:
        """Shut down, unless it has ended."""
        if not self.ended.is_set():
            self.ask("shutdown")
        self.thread.join(LIMIT_S)
        assert not self.thread.is_alive()

    def _note(self, end: ExitReport) -> None:
        self.end = end
        self.ended.set()


class Lockstep:
    """Components in virtual time on a bus in memory."""

    def __init__(self) -> None:
        self.executor = LockstepExecutor()
        self.bus = LockstepBus()
        self.observer = self.bus.node("/observer", _ignore)

    def add(self, component: type[C], /, **launch: Any) -> "Placed[C]":
        """Add a component, unconfigured."""
        return Placed(self, component, **launch)

    def read(self, topic: str, message: type[Any], qos: Qos = RELIABLE) -> LockstepSubscription:
        """Return a subscription to a topic."""
        qos = qos.with_depth(1_000_000)
        return self.observer.subscribe(full_name("robot", topic), message, qos, _nothing)

    def publish(self, topic: str, *messages: Any, qos: Qos = RELIABLE) -> None:
        """Publish messages on a topic."""
        writer = self.observer.advertise(full_name("robot", topic), type(messages[0]), qos)
        for message in messages:
            writer.publish(message)
        if qos is not LATCHED:
            writer.close()

    def run_until(self, time: int) -> None:
        """Run until that time [ns], with what follows at once."""
        over: list[bool] = []

        def leave(turns: int) -> None:
            if turns:
                self.executor.at(time, lambda: leave(turns - 1))
            else:
                over.append(True)

        self.executor.at(time, lambda: leave(100))
        self.executor.run(lambda: bool(over))

    def run(self) -> None:
        """Run what is due now."""
        self.run_until(self.executor.now())


class Placed(Generic[C]):
    """A component in lockstep."""

    def __init__(self, lockstep: Lockstep, component: type[C], /, **launch: Any) -> None:
        self.ends: list[ExitReport] = []
        request = launch_request(**launch)
        self.runtime = Runtime(
            component, request, lockstep.bus, lockstep.executor.scheduler(), lockstep.executor,
            self.ends.append,
        )  # fmt: skip

    @property
    def component(self) -> C:
        """The component."""
        return cast("C", self.runtime.component)

    @property
    def state(self) -> str:
        """Its life-cycle state."""
        return self.runtime.state.value

    def ask(self, verb: str, **arguments: Any) -> Any:
        """Return the reply to a control request."""
        return self.runtime.request(verb, arguments)

    def activate(self) -> None:
        """Configure and activate."""
        self.ask("configure")
        self.ask("activate")


def taken(subscription: LockstepSubscription) -> list[Any]:
    """Return all pending messages."""
    return list(iter(subscription.take, None))


def _nothing() -> None:
    """Wake nothing."""


def _ignore(complaint: str) -> None:
    """Ignore error reports."""
