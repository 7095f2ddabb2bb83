"""Measures time without the pauses in which the machine did not let this process run."""

import threading
import time
from collections.abc import Callable

PERIOD_S = 0.25
PAUSE_S = 1.0
"""A thread that should run four times a second and has not run for so long was kept from it."""


class PauseAwareClock:
    """Counts the seconds in which this process could run; a thread of its own observes that.

    Of a pause only `PAUSE_S` count: a component that is silent or does not return meanwhile does
    not hang. A call that lets no other thread run is not a pause: it uses processor time itself.
    """

    def __init__(
        self,
        monotonic: Callable[[], float] = time.monotonic,
        processor_time: Callable[[], float] = time.process_time,
    ) -> None:
        self._monotonic = monotonic
        self._processor_time = processor_time
        self._used_s = processor_time()
        self._last = (0.0, monotonic())  # counted so far, and when; replaced as one
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cairn clock", daemon=True)

    def start(self) -> None:
        """Start to observe."""
        self._thread.start()

    def now(self) -> float:
        """Return the time [s] since the start; from any thread."""
        counted_s, at = self._last
        return counted_s + min(self._monotonic() - at, PAUSE_S)

    def update(self) -> None:
        """Count the time since the last update; of a pause only `PAUSE_S`."""
        counted_s, at = self._last
        now, used_s = self._monotonic(), self._processor_time()
        passed_s = now - at
        if passed_s > PAUSE_S and used_s - self._used_s < passed_s / 2:
            passed_s = PAUSE_S
        self._used_s = used_s
        self._last = (counted_s + passed_s, now)

    def close(self) -> None:
        """Stop observing."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._closed.wait(PERIOD_S):
            self.update()
