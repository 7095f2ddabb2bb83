"""The camera's driver on a loop of its own, its ports in the test's hands."""

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

_LOOK_S = 0.05
_ALL = Qos("reliable", "transient_local", 10_000)


class Driver:
    """The camera's driver, active, on a loop of its own; a context manager that shuts it down."""

    restarts = 0

    def __init__(self, **parameters: Any) -> None:
        """Configure and activate it; raises `CairnError` if it cannot be."""
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
        self._came = threading.Event()
        test = bus.node("/robot/test", self.runtime.log.error)
        self._readers = {
            port.name: test.subscribe(f"/robot/{port.name}", port.message, _ALL, self._came.set)
            for port in ports_of(V4l2StereoCamera).values()
        }
        self._thread = threading.Thread(target=self._loop.run, daemon=True)
        self._thread.start()
        self.go("configure", "activate")

    def go(self, *steps: str) -> None:
        """Walk its life cycle."""
        for step in steps:
            self.ask(partial(self.runtime.transition, Transition(step)))

    def set(self, **changes: Any) -> None:
        """Change parameters; `controls__gain` is `controls.gain`."""
        named = {name.replace("__", "."): value for name, value in changes.items()}
        self.ask(lambda: self.runtime.set_parameters(named))

    def ask(self, call: Callable[[], None]) -> None:
        """Have a call made by its loop; raises what that raises."""
        done = threading.Event()
        failures: list[Exception] = []

        def made() -> None:
            try:
                call()
            except Exception as error:
                failures.append(error)
            done.set()

        self._loop.post(made)
        assert done.wait(LIMIT_S), "the driver's loop is held up"
        if failures:
            raise failures[0]

    def taken(self, port: str) -> list[Any]:
        """What it has sent since the last look."""
        messages = []
        while (message := self._readers[port].take()) is not None:
            messages.append(message)
        return messages

    def await_one(
        self, port: str, test: Callable[[Any], bool] = lambda _: True, limit_s: float = LIMIT_S
    ) -> Any:
        """Wait for a message that passes the test."""
        until = time.monotonic() + limit_s
        seen: list[Any] = []
        while (left_s := until - time.monotonic()) > 0:
            self._came.clear()
            for message in self.taken(port):
                seen.append(message)
                if test(message):
                    return message
            self._came.wait(left_s)
        raise AssertionError(f"no such message on {port} within {limit_s:g} s; {seen[-3:]}")

    def await_pictures(self, count: int) -> list[Any]:
        """Wait for so many left images from now on."""
        self.taken("left_image")
        return [self.await_one("left_image") for _ in range(count)]

    def tell(self) -> None:
        """Have it tell diagnostics now, as it does once a second by itself."""
        component = self.runtime.component
        assert isinstance(component, V4l2StereoCamera)
        self.ask(component.tell)

    def values(self, index: int = 0) -> dict[str, str]:
        """What diagnostics tell now: of the camera so numbered, or of the pair (2)."""
        self.taken("diagnostics")
        self.tell()
        status = self.taken("diagnostics")[-1].status[index]
        told = {value.key: value.value for value in status.values}
        return told | {"level": str(status.level), "message": status.message}

    def await_values(
        self, test: Callable[[dict[str, str]], bool], index: int = 0
    ) -> dict[str, str]:
        """Wait for diagnostics that pass the test."""
        until = time.monotonic() + LIMIT_S
        while not test(told := self.values(index)):
            assert time.monotonic() < until, f"diagnostics stay {told}"
            self._came.clear()
            self._came.wait(_LOOK_S)
        return told

    def await_end(self) -> None:
        """Wait until it has ended."""
        self._thread.join(LIMIT_S)
        assert self.ends, "it does not end"

    def __enter__(self) -> Self:
        """It is active already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Shut it down, and wait for its end."""
        if not self.ends:
            self.go("shutdown")
        self._thread.join(LIMIT_S)
        assert not self._thread.is_alive()


class RestartedDriver(Driver):
    """One that its supervisor has started before."""

    restarts = 1
