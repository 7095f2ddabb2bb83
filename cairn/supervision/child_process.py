"""A process started through a zygote, as its owner sees it: signals, and how it ended."""

import contextlib
import signal
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

WITHOUT_SUCCESS = 100
"""The exit code of a process whose work is over, but was not done."""


@dataclass(frozen=True)
class ChildExit:
    """How a process ended: with an exit code or by a signal; the other one is None."""

    pid: int
    name: str
    code: int | None
    signal: int | None

    @property
    def normal(self) -> bool:
        """Whether it ended by itself and with its work over, with success or without."""
        return self.code in (0, WITHOUT_SUCCESS)

    @property
    def manner(self) -> str:
        """How it ended in words, such as "was killed by SIGSEGV"."""
        if self.signal is None:
            return f"ended with exit code {self.code}"
        return f"was killed by {_signal_name(self.signal)}"

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid}) {self.manner}"


class ChildProcess:
    """A process started through a zygote; it leads a process group of its own."""

    def __init__(self, name: str, pid: int, send: Callable[[int, int, bool], None]) -> None:
        """`send` takes process id, signal number and whether the group is meant."""
        self.name = name
        self.pid = pid
        self._send = send
        self._exit: Future[ChildExit] = Future()

    @property
    def exit(self) -> ChildExit | None:
        """How it ended, None while it runs."""
        return self._exit.result(0) if self._exit.done() else None

    def wait(self, timeout_s: float) -> ChildExit | None:
        """Wait for its end and that of its process group; None if it still runs then."""
        with contextlib.suppress(TimeoutError):
            return self._exit.result(timeout_s)
        return None

    def on_end(self, call: Callable[["ChildProcess"], None]) -> None:
        """Have `call` made once it has ended, on the client's thread; at once if it has."""
        self._exit.add_done_callback(lambda _: call(self))

    def signal(self, number: int) -> None:
        """Send a signal to the process alone, nothing if it has ended.

        Raises `CairnError` if the zygote does not answer.
        """
        if not self._exit.done():
            self._send(self.pid, number, False)

    def terminate(self) -> None:
        """Ask it to end, by SIGTERM."""
        self.signal(signal.SIGTERM)

    def kill(self) -> None:
        """Kill its whole process group, nothing if it has ended; see `signal`."""
        if not self._exit.done():
            self._send(self.pid, signal.SIGKILL, True)

    def ended(self, how: ChildExit) -> None:
        """For the zygote's client: note how it ended."""
        self._exit.set_result(how)


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time signal
        return f"signal {number}"
