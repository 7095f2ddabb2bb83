"""What a device measures, from the thread that hears it to the handlers that publish it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

from cairn.driver.device_thread import DeviceThread
from cairn.driver.errors import DeviceError
from cairn.driver.rate import RateWindow
from cairn.runtime.component import Component

T = TypeVar("T")

_MOST_WAITING = 5


class DeviceFeed(Generic[T]):
    """The frame of a driver: a thread that talks with the device, and what the component tells.

    On the thread `converse(stopping)`, as `DeviceThread` takes it, hands over what it hears by
    `give`. Among the component's handlers `publish` is called with each. If that is slower than
    the device, the oldest go, and are counted. A mistake in `converse` fails the component.
    """

    def __init__(
        self,
        component: Component,
        converse: Callable[[threading.Event], None],
        publish: Callable[[T], None],
    ) -> None:
        self.rate = RateWindow()
        """How often something was published."""
        self.trouble = ""
        """What is the matter with the device; empty once something came from it."""
        self.left_out = 0
        """How many have gone because too many were waiting."""
        self._component = component
        self._converse = converse
        self._publish = publish
        self._waiting: deque[T] = deque(maxlen=_MOST_WAITING)
        self._thread: DeviceThread | None = None

    def start(self) -> None:
        """Begin to talk with the device: when the component is activated."""
        self.rate.restart()
        self._waiting.clear()  # what came while it was being deactivated
        self._thread = DeviceThread(
            self._component.name,
            self._converse,
            log=self._component.log,
            on_trouble=lambda error: self._component.post(partial(self._lost, error)),
            on_failure=lambda error: self._component.post(partial(_fail, error)),
        )
        self._thread.start()

    def stop(self) -> None:
        """End the conversation, if there is one; raises `CairnError` if that takes too long."""
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.stop()

    def well(self, what: str) -> None:
        """Say, from within `converse`, that the device works: `what` is logged after trouble."""
        if (thread := self._thread) is not None:
            thread.well(what)

    def give(self, heard: T) -> None:
        """Hand over, from within `converse`, what is to be published."""
        if len(self._waiting) == _MOST_WAITING:
            self.left_out += 1
        self._waiting.append(heard)
        self._component.post(self._next)

    def hz(self) -> float:
        """How often something was published of late [Hz]."""
        return self.rate.hz(time.monotonic())

    def _next(self) -> None:
        if not self._waiting:
            return
        heard = self._waiting.popleft()
        self.rate.note(time.monotonic())
        self.trouble = ""
        self._publish(heard)

    def _lost(self, error: DeviceError) -> None:
        self.trouble = str(error)
        self.rate.restart()


def _fail(error: Exception) -> None:
    raise error
