"""A thread on which a driver talks with its device, and begins anew when that fails."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from cairn.driver.errors import DeviceError
from cairn.errors import CairnError
from cairn.runtime.rate_limited_log import RateLimitedLog

RETRY_S = 0.2
"""How long after a failure the device is tried again: soon, as it may have come back."""

_STOP_LIMIT_S = 4.0  # less than its supervisor waits for the component


class DeviceThread:
    """Runs `converse` on a thread of its own, again and again, until it is stopped.

    `converse(stopping)` opens the device, talks with it until `stopping` is set, at which it
    looks at least ten times a second, and lets go of the device however it ends. What it
    reads it hands to the component by `Component.post`. A `DeviceError` is logged (without
    flooding the log), handed to `on_trouble`, and the device is tried again; any other exception is
    a mistake in the driver, and handed to `on_failure`, which fails the component.
    """

    def __init__(
        self,
        name: str,
        converse: Callable[[threading.Event], None],
        *,
        log: logging.Logger,
        on_trouble: Callable[[DeviceError], None],
        on_failure: Callable[[Exception], None],
    ) -> None:
        self._converse = converse
        self._warnings = RateLimitedLog(log)
        self._on_trouble = on_trouble
        self._on_failure = on_failure
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin; once only."""
        self._thread.start()

    def well(self, what: str) -> None:
        """Say, from within `converse`, that the device works: `what` is logged after trouble."""
        self._warnings.resolved("device", what)

    def stop(self) -> None:
        """End the conversation, and wait for that; raises `CairnError` if it takes too long."""
        self._stopping.set()
        self._thread.join(_STOP_LIMIT_S)
        if self._thread.is_alive():
            raise CairnError(
                f"{self._thread.name}: its thread does not end within {_STOP_LIMIT_S:g} s; the "
                "device is still in use"
            )

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._converse(self._stopping)
            except DeviceError as error:
                self._warnings.warn("device", str(error))
                self._on_trouble(error)
            except Exception as error:
                self._on_failure(error)
                return
            self._stopping.wait(RETRY_S)
