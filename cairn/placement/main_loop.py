"""The main thread of a process that hosts components: heartbeats, and signals to stop."""

import contextlib
import queue
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from cairn.placement.component_host import ComponentHost

HEARTBEAT_S = 0.25
_WAKE_UP = 0  # not the number of any signal


class MainLoop:
    """Runs until a component has ended; a stop signal such as Ctrl-C has it shut down."""

    def __init__(self, host: ComponentHost) -> None:
        self._host = host
        # Signal numbers, or `_WAKE_UP`. Unlike an Event it may be used by a signal handler at any
        # moment.
        self._inbox: queue.SimpleQueue[int] = queue.SimpleQueue()
        host.on_exit = self.wake_up

    def run(self, on_turn: Callable[[], None] = lambda: None, *, force: bool = False) -> bool:
        """Publish heartbeats until the component has ended, and call `on_turn` with each of them.

        `on_turn` is called a last time after the end. With `force`, a second stop signal ends the
        loop before the component has ended; then the result is False.
        """
        stopping = False
        due = time.monotonic()
        while not self._host.ended.is_set():
            if self._received_signal(due - time.monotonic()):
                if stopping and force:
                    return False
                stopping = True
                self.stop()
            if time.monotonic() >= due:
                due = time.monotonic() + HEARTBEAT_S
                self._host.publish_heartbeats()
            on_turn()
        on_turn()
        return True

    def wake_up(self) -> None:
        """Have the next turn made at once; from any thread."""
        self._inbox.put(_WAKE_UP)

    def stop(self) -> None:
        """Have the component shut down; starts in progress below it are cut short."""
        self._host.request_stop()
        self._host.send_request("shutdown")

    @contextmanager
    def stop_signals(self, *numbers: signal.Signals) -> Iterator[None]:
        """Treat these signals as requests to stop."""
        before = {number: signal.signal(number, self._on_signal) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _on_signal(self, number: int, _: FrameType | None) -> None:
        self._inbox.put(number)

    def _received_signal(self, timeout_s: float) -> bool:
        with contextlib.suppress(queue.Empty):
            return self._inbox.get(timeout=max(0.0, timeout_s)) != _WAKE_UP
        return False
