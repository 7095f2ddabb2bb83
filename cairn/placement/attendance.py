"""The main thread of a process that hosts components: heartbeats, stop signals, the end."""

import contextlib
import queue
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from cairn.placement.launchers import Household

HEARTBEAT_S = 0.25


class Attendance:
    """Sees to a component until it has ended; a stop signal has it shut down in good order."""

    def __init__(self, household: Household) -> None:
        self._household = household
        self._hosted = household.hosted
        # Signals, or 0 for a turn at once. Unlike an Event it may be filled from a signal handler,
        # whatever is under way.
        self._news: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._hosted.on_end = self.hurry

    def until_end(self, each_turn: Callable[[], None], *, impatient: bool) -> bool:
        """Publish heartbeats and make `each_turn` with them, until the component has ended.

        Returns False, before the end, if `impatient` and a second stop signal comes.
        """
        stopping = False
        due = time.monotonic()
        while not self._hosted.ended.is_set():
            if self._news_of_signal(due - time.monotonic()):
                if stopping and impatient:
                    return False
                stopping = True
                self.stop()
            if time.monotonic() >= due:
                due = time.monotonic() + HEARTBEAT_S
                self._household.heartbeat()
            each_turn()
        return True

    def hurry(self) -> None:
        """Have the next turn made at once; from any thread."""
        self._news.put(0)

    def stop(self) -> None:
        """Have the component shut down; starts that are under way below it are cut short."""
        self._household.request_stop()
        self._hosted.ask("shutdown")

    @contextmanager
    def signals(self, *numbers: signal.Signals) -> Iterator[None]:
        """Take these signals as orders to stop."""
        before = {number: signal.signal(number, self._note) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _note(self, number: int, _: FrameType | None) -> None:
        self._news.put(number)

    def _news_of_signal(self, timeout_s: float) -> bool:
        with contextlib.suppress(queue.Empty):
            return self._news.get(timeout=max(0.0, timeout_s)) != 0
        return False
