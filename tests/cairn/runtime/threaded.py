"""A component on a thread of its own, in real time: for drivers and for what a thread guarantees.

Everything else runs in virtual time: see `cairn.testing.lockstep`.
"""

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, TypeVar

from cairn import Component
from cairn.bus.bus import Bus
from cairn.deployment.model import Deployment
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.loop import ThreadLoop
from cairn.runtime.process_exit import ExitReport
from cairn.runtime.runtime import Runtime
from cairn.system.clock import SystemClock
from tests.patience import LIMIT_S

T = TypeVar("T")


class ThreadedComponent:
    """A component on a thread of its own, unconfigured at first."""

    def __init__(
        self,
        component: type[Component],
        bus: Bus,
        *,
        name: str = "component",
        parameters: dict[str, Any] | None = None,
        topics: dict[str, str] | None = None,
        restarts: int = 0,
        simulated_time: bool = False,
        deployment: Deployment | None = None,
    ) -> None:
        """Construct it, and start its thread; raises `CairnError` if that fails."""
        self.loop = ThreadLoop()
        self.ended = threading.Event()
        self.end: ExitReport | None = None
        launch = LaunchRequest(
            name=name,
            spec=ChildSpec(
                plugin=f"{component.__module__}:{component.__qualname__}",
                parameters=parameters or {},
                topics=topics or {},
            ),
            incarnation=1 + restarts,
            context=RunContext(
                simulated_time=simulated_time,
                robot="robot" if deployment is None else deployment.robot.name,
                deployment="" if deployment is None else deployment.model_dump_json(),
            ),
        )
        self.runtime = Runtime(component, launch, bus, self.loop, SystemClock(), self._note_end)
        self.thread = threading.Thread(target=self.loop.run, daemon=True)
        self.thread.start()

    def call(self, function: Callable[[], T]) -> T:
        """Call a function on its thread; return its result, or raise what it raises."""
        result: Future[T] = Future()

        def make() -> None:
            try:
                result.set_result(function())
            except Exception as error:
                result.set_exception(error)

        self.loop.post(make)
        return result.result(LIMIT_S)

    def request(self, verb: str, **arguments: Any) -> Any:
        """Return the reply to a control request; raises `CairnError` if it refuses."""
        return self.call(lambda: self.runtime.request(verb, arguments))

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Change parameters, all or none; raises `ParameterRejected` if it refuses."""
        self.request("set_parameters", **changes)

    def activate(self) -> None:
        """Configure and activate."""
        self.request("configure")
        self.request("activate")

    def close(self) -> None:
        """Shut down, unless it has ended, and wait for the end of its thread."""
        if not self.ended.is_set():
            self.request("shutdown")
        self.join()

    def join(self) -> None:
        """Wait for the end of its thread."""
        self.thread.join(LIMIT_S)
        assert not self.thread.is_alive()

    def _note_end(self, end: ExitReport) -> None:
        self.end = end
        self.ended.set()
