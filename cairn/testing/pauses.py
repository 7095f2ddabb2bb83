"""Whether the machine itself paused while something was judged that goes on in real time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

import pytest

_NAP_S = 0.005
_TRIES = 3
_MOST = 0.1
"""Share of the time that the machine may be away while a sample is taken."""

T = TypeVar("T")


class Pauses:
    """A thread that naps again and again: by what it oversleeps the machine was away, or too busy.

    A context manager; `lost_s` [s] in sum, `longest_s` [s] at once, and the `share` [1] of the time
    of the context are there at its end.
    """

    def __enter__(self) -> Pauses:
        """Begin."""
        self.lost_s = self.longest_s = 0.0
        self._over = threading.Event()
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._nap, name="pauses", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._over.set()
        self._thread.join()
        self.share = self.lost_s / (time.monotonic() - self._began)

    def _nap(self) -> None:
        while True:
            due = time.monotonic() + _NAP_S
            is_over = self._over.wait(_NAP_S)
            late_s = time.monotonic() - due
            if late_s > _NAP_S:
                self.lost_s += late_s
                self.longest_s = max(self.longest_s, late_s)
            if is_over:
                return


def undisturbed(take: Callable[[], T]) -> T:
    """What `take` gives, taken while the machine was there: of a driver nothing else tells.

    A sample is taken anew, three times in all, if the machine was away for a tenth of its time; if
    it always is, the test is skipped, with the reason.
    """
    for _ in range(_TRIES):
        with Pauses() as pauses:
            taken = take()
        if pauses.share <= _MOST:
            return taken
    pytest.skip(
        f"this machine is too busy for what is judged in real time: it paused for "
        f"{pauses.longest_s:.2f} s at once, {pauses.share:.0%} of the time, in each of {_TRIES} "
        "samples; run the test on a quiet one"
    )
