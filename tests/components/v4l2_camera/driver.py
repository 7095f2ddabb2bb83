"""Run the camera driver in real time on a loop of its own, with access to its ports."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Self

from cairn import Qos
from cairn.bus.lockstep_bus import LockstepBus
from cairn.clock import SystemClock
from cairn.components.v4l2_camera.component import V4l2StereoCamera
from cairn.deployment.model import ChildSpec
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import Transition
from cairn.runtime.loop import ThreadLoop
from cairn.runtime.ports import ports_of
from cairn.runtime.runtime import Runtime
from tests.patience import LIMIT_S

_POLL_S = 0.05
_ALL = Qos("reliable", "transient_local", 10_000)


class Driver:
    """The active camera driver on a loop of its own; a context manager that shuts it down."""

    restarts = 0

    def __init__(self, **parameters: Any) -> None:
        """Configure and activate it; raises `CairnError` if that fails."""
        self.ends: list[ExitReport] = []
        self._loop = ThreadLoop()
        bus = LockstepBus()
        launch = LaunchRequest(
            name="camera",
            spec=ChildSpec(plugin="v4l2", parameters=parameters),
            incarnation=1 + self.restarts,
        )
        self.runtime = Runtime(
            V4l2StereoCamera, launch, bus, self._loop, SystemClock(), self.ends.append
        )
        self._arrived = threading.Event()
        test = bus.node("/robot/test", self.runtime.log.error)
        self._readers = {
            port.name: test.subscribe(f"/robot/{port.name}", port.message, _ALL, self._arrived.set)
            for port in ports_of(V4l2StereoCamera).values()
        }
        self._thread = threading.Thread(target=self._loop.run, daemon=True)
        self._thread.start()
        self.transition("configure", "activate")

    def transition(self, *steps: str) -> None:
        """Request transitions of its life cycle."""
        for step in steps:
            self.call(partial(self.runtime.transition, Transition(step)))

    def set(self, **changes: Any) -> None:
        """Change parameters; `controls__gain` is `controls.gain`."""
        named = {name.replace("__", "."): value for name, value in changes.items()}
        self.call(lambda: self.runtime.set_parameters(named))

    def call(self, function: Callable[[], None]) -> None:
        """Call a function on its loop; raises what that raises."""
        done = threading.Event()
        failures: list[Exception] = []

        def run() -> None:
            try:
                function()
            except Exception as error:
                failures.append(error)
            done.set()

        self._loop.post(run)
        assert done.wait(LIMIT_S), "the driver's loop is blocked"
        if failures:
            raise failures[0]

    def take(self, port: str) -> list[Any]:
        """Return the messages sent since the last call."""
        messages = []
        while (message := self._readers[port].take()) is not None:
            messages.append(message)
        return messages

    def await_one(
        self, port: str, test: Callable[[Any], bool] = lambda _: True, limit_s: float = LIMIT_S
    ) -> Any:
        """Wait for a message for which `test` holds."""
        deadline = time.monotonic() + limit_s
        received: list[Any] = []
        while (left_s := deadline - time.monotonic()) > 0:
            self._arrived.clear()
            for message in self.take(port):
                received.append(message)
                if test(message):
                    return message
            self._arrived.wait(left_s)
        raise AssertionError(f"no such message on {port} within {limit_s:g} s; {received[-3:]}")

    def await_images(self, count: int) -> list[Any]:
        """Wait for `count` left images from now on."""
        self.take("left_image")
        return [self.await_one("left_image") for _ in range(count)]

    def publish_health(self) -> None:
        """Publish diagnostics now, as it does once per second by itself."""
        component = self.runtime.component
        assert isinstance(component, V4l2StereoCamera)
        self.call(component.publish_health)

    def values(self, index: int = 0) -> dict[str, str]:
        """Return the present diagnostics of a camera (0, 1) or of the pair (2)."""
        self.take("diagnostics")
        self.publish_health()
        status = self.take("diagnostics")[-1].status[index]
        values = {value.key: value.value for value in status.values}
        return values | {"level": str(status.level), "message": status.message}

    def await_values(
        self, test: Callable[[dict[str, str]], bool], index: int = 0
    ) -> dict[str, str]:
        """Wait for diagnostics for which `test` holds."""
        deadline = time.monotonic() + LIMIT_S
        while not test(values := self.values(index)):
            assert time.monotonic() < deadline, f"diagnostics remain {values}"
            self._arrived.clear()
            self._arrived.wait(_POLL_S)
        return values

    def await_end(self) -> None:
        """Wait for its end."""
        self._thread.join(LIMIT_S)
        assert self.ends, "it has not ended"

    def __enter__(self) -> Self:
        """It is active already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Shut it down, and wait for its end."""
        if not self.ends:
            self.transition("shutdown")
        self._thread.join(LIMIT_S)
        assert not self._thread.is_alive()


class RestartedDriver(Driver):
    """A driver that its supervisor has restarted."""

    restarts = 1
