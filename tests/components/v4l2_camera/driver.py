"""Run the camera driver in real time on a thread of its own, and read what it publishes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Self

from cairn import Qos
from cairn.bus.lockstep_bus import LockstepBus
from cairn.components.v4l2_camera.component import V4l2StereoCamera
from cairn.runtime.ports import ports_of
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.patience import LIMIT_S

_POLL_S = 0.05
_ALL = Qos("reliable", "transient_local", 10_000)
_NEVER_S = 60.0
"""Time without an image that no test reaches, however busy the machine: as long as allowed."""


class _Camera(V4l2StereoCamera):
    """The driver without its timer: diagnostics are of what happened since the test read them."""

    def publish_health(self) -> None:
        super().publish_health()


class Driver(ThreadedComponent):
    """The active camera driver on a thread of its own; a context manager that shuts it down.

    It restarts a silent stream only if the test sets `silence_s`.
    """

    def __init__(self, *, restarts: int = 0, **parameters: Any) -> None:
        """Configure and activate it; raises `CairnError` if that fails."""
        bus = LockstepBus()
        parameters = {"silence_s": _NEVER_S, **parameters}
        super().__init__(_Camera, bus, name="camera", parameters=parameters, restarts=restarts)
        self._arrived = threading.Event()
        test = bus.node("/robot/test", self.runtime.log.error)
        self._readers = {
            port.name: test.subscribe(
                f"/robot/{port.name}", port.interface, _ALL, self._arrived.set
            )
            for port in ports_of(V4l2StereoCamera).values()
        }
        self.activate()

    def set(self, **changes: Any) -> None:
        """Change parameters; `controls__gain` is `controls.gain`."""
        self.set_parameters({name.replace("__", "."): value for name, value in changes.items()})

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
        """Publish diagnostics now, as it does once per second outside of these tests."""
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

    def __enter__(self) -> Self:
        """It is active already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Shut it down, and wait for its end."""
        self.close()
