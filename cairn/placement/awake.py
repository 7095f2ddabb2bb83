"""Time without that in which the machine did not let this process run."""

import threading
import time
from collections.abc import Callable

TURN_S = 0.25
LATE_S = 1.0
"""A thread that is to run four times a second, and has not for so long, was kept from it."""


class AwakeTime:
    """Seconds in which this process could run, as a thread of its own finds out, once started.

    Of a pause only `LATE_S` count: who is silent meanwhile, or does not finish, is not to blame.
    A call that lets no other thread run is no pause: it uses the processor itself.
    """

    def __init__(
        self,
        monotonic: Callable[[], float] = time.monotonic,
        processor: Callable[[], float] = time.process_time,
    ) -> None:
        self._monotonic = monotonic
        self._processor = processor
        self._used_s = processor()
        self._last = (0.0, monotonic())  # awake so far, and when that was; exchanged as one
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._turn_always, name="cairn awake", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def now(self) -> float:
        """Time [s] since the beginning; from any thread."""
        awake_s, at = self._last
        return awake_s + min(self._monotonic() - at, LATE_S)

    def turn(self) -> None:
        """See how long it has been since the last turn, and whether this process ran meanwhile."""
        awake_s, at = self._last
        now, used_s = self._monotonic(), self._processor()
        passed_s = now - at
        if passed_s > LATE_S and used_s - self._used_s < passed_s / 2:
            passed_s = LATE_S
        self._used_s = used_s
        self._last = (awake_s + passed_s, now)

    def close(self) -> None:
        """Look no more."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def _turn_always(self) -> None:
        while not self._closed.wait(TURN_S):
            self.turn()
