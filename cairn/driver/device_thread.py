"""The thread on which a driver talks with its device, and its way to the component's handlers.

A device that fails or is unplugged is reopened here, and measurements that the component has no
time for are dropped here.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

from cairn.driver.diagnostics import RateWindow
from cairn.driver.errors import DeviceError
from cairn.errors import CairnError
from cairn.runtime.component import Component
from cairn.runtime.rate_limited_log import RateLimitedLog

T = TypeVar("T")

RETRY_S = 0.2
"""How long after a failure the device is opened again: soon, as it may have come back."""

_STOP_LIMIT_S = 4.0  # less than the supervisor waits for the component
_QUEUE_DEPTH = 5


class DeviceThread:
    """Runs `serve` on a thread of its own, again after each failure, until it is stopped.

    `serve(stopping)` opens the device, talks with it until `stopping` is set, which it checks at
    least ten times a second, and closes the device however it ends. It passes measurements to the
    component by `Component.post`. A `DeviceError` is logged (rate-limited), passed to
    `on_device_error`, and the device is opened again. Any other exception is a bug in the driver:
    it is passed to `on_failure`, which fails the component. So is `sys.exit`, as a `CairnError`.
    """

    def __init__(
        self,
        name: str,
        serve: Callable[[threading.Event], None],
        *,
        log: logging.Logger,
        on_device_error: Callable[[DeviceError], None],
        on_failure: Callable[[Exception], None],
    ) -> None:
        self._serve = serve
        self._warnings = RateLimitedLog(log)
        self._on_device_error = on_device_error
        self._on_failure = on_failure
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread; once only."""
        self._thread.start()

    def report_working(self, text: str) -> None:
        """Report, from within `serve`, that the device works; logs `text` after a failure."""
        self._warnings.resolved("device", text)

    def stop(self) -> None:
        """Stop `serve` and wait for its end; raises `CairnError` if that takes too long."""
        self._stopping.set()
        self._thread.join(_STOP_LIMIT_S)
        if self._thread.is_alive():
            raise CairnError(
                f"{self._thread.name}: the device thread did not stop within {_STOP_LIMIT_S:g} s; "
                "the device is still in use"
            )

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._serve(self._stopping)
            except DeviceError as error:
                self._warnings.warn("device", str(error))
                self._on_device_error(error)
            except SystemExit as error:  # without a handler it would end the thread silently
                text = f"the device thread called sys.exit({error.code}); raise DeviceError instead"
                self._on_failure(CairnError(f"{self._thread.name}: {text}"))
                return
            except Exception as error:
                self._on_failure(error)
                return
            self._stopping.wait(RETRY_S)


class DeviceFeed(Generic[T]):
    """The frame of a driver: a device thread, and a queue from it to the component's handlers.

    On the thread `serve(stopping)`, as `DeviceThread` takes it, passes each measurement to `put`.
    `publish` is called with each of them as one of the component's handlers. If the handlers are
    slower than the device, the oldest measurements are dropped and counted.
    """

    def __init__(
        self,
        component: Component,
        serve: Callable[[threading.Event], None],
        publish: Callable[[T], None],
    ) -> None:
        self.rate = RateWindow()
        """Measures how often a measurement is published."""
        self.device_error = ""
        """The last device error; empty once a measurement has arrived since."""
        self.dropped = 0
        """How many measurements were dropped because the component was busy."""
        self._component = component
        self._serve = serve
        self._publish = publish
        self._queue: deque[T] = deque(maxlen=_QUEUE_DEPTH)
        self._thread: DeviceThread | None = None

    def start(self) -> None:
        """Start talking with the device; to be called from `on_activate`."""
        self.rate.restart()
        self._queue.clear()  # what arrived while the component was being deactivated
        self._thread = DeviceThread(
            self._component.name,
            self._serve,
            log=self._component.log,
            on_device_error=lambda error: self._component.post(partial(self._note_error, error)),
            on_failure=lambda error: self._component.post(partial(_fail, error)),
        )
        self._thread.start()

    def stop(self) -> None:
        """Stop the device thread, if it runs; raises `CairnError` if that takes too long."""
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.stop()

    def report_working(self, text: str) -> None:
        """Report, from within `serve`, that the device works; logs `text` after a failure."""
        if (thread := self._thread) is not None:
            thread.report_working(text)

    def put(self, measurement: T) -> None:
        """Pass on, from within `serve`, a measurement to be published."""
        if len(self._queue) == _QUEUE_DEPTH:
            self.dropped += 1
        self._queue.append(measurement)
        self._component.post(self._publish_next)

    def hz(self) -> float:
        """Return how often a measurement was published in the last seconds [Hz]."""
        return self.rate.hz(time.monotonic())

    def _publish_next(self) -> None:
        if not self._queue:
            return
        measurement = self._queue.popleft()
        self.rate.note(time.monotonic())
        self.device_error = ""
        self._publish(measurement)

    def _note_error(self, error: DeviceError) -> None:
        self.device_error = str(error)
        self.rate.restart()


def _fail(error: Exception) -> None:
    raise error
