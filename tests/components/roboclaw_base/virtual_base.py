"""A base on an emulated RoboClaw in virtual time: no busy computer makes it late."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from cairn.driver.errors import LinkLost
from tests.components.roboclaw_base.emulated_base import ObservedBase
from tests.patience import LIMIT_S

_REPLY_S = 0.001  # from a packet to its reply


class VirtualBase(ObservedBase):
    """The controller, its line, and their time, which passes when the driver waits.

    It stands for the module `time` of the driver. `pause` may be replaced: by what lets the driver
    go on.
    """

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self._now = 100.0
        self._plugged = True
        self.on_sleep: Callable[[], None] = lambda: None
        self.on_pause: Callable[[], None] = lambda: self.pass_time(0.005)
        self.device.powered_on(self._now)
        for module in ("drive_loop", "client", "probe_cli"):
            patch.setattr(f"cairn.components.roboclaw_base.{module}.time", self)

    def open(self, *_: object) -> VirtualLine:
        """Open the line; raises `LinkLost` while it is unplugged."""
        self.check_plugged()
        return VirtualLine(self)

    def unplug(self) -> None:
        self._plugged = False

    def plug_in(self) -> None:
        self._plugged = True
        self.device.powered_on(self._now)

    def check_plugged(self) -> None:
        if not self._plugged:
            raise LinkLost("the line is unplugged")

    def call(self, function: Callable[[], object]) -> None:
        function()

    def pause(self) -> None:
        self.on_pause()

    def pass_time(self, seconds: float) -> None:
        self._now += seconds
        self.device.advance(self._now)

    def monotonic(self) -> float:
        return self._now

    def time_ns(self) -> int:
        return round(1e9 * self._now)

    def sleep(self, seconds: float) -> None:
        self.pass_time(seconds)
        self.on_sleep()


class VirtualLine:
    """A `Link` to the controller. It is lost for good once it is unplugged."""

    name = "line"
    paced = False

    def __init__(self, base: VirtualBase) -> None:
        self._base = base
        self._received = b""

    def read(self, timeout_s: float) -> bytes:
        self._base.check_plugged()
        received, self._received = self._received, b""
        if not received:
            self._base.pass_time(timeout_s)
        return received

    def write(self, data: bytes) -> None:
        self._base.check_plugged()
        self._base.pass_time(_REPLY_S)
        self._received += b"".join(self._base.device.receive(data, self._base.monotonic()))

    def set_baud(self, baud: int) -> None:
        pass

    def discard(self) -> None:
        self._base.check_plugged()
        self._received = b""

    def close(self) -> None:
        pass


class TakingTurns:
    """A thread that runs only while the test waits for it, from one `yield_turn` to the next."""

    def __init__(self, run: Callable[[], None]) -> None:
        self._run = run
        self._may_run, self._has_run = threading.Semaphore(0), threading.Semaphore(0)
        self.ended = False
        threading.Thread(target=self._run_to_end, daemon=True).start()

    def take_turn(self) -> None:
        """Let it run until it yields or ends. For the test."""
        if not self.ended:
            self._may_run.release()
            assert self._has_run.acquire(timeout=LIMIT_S), "the thread waits for something else"

    def yield_turn(self) -> None:
        """Let the test continue, until it waits for the next turn. For the thread."""
        self._has_run.release()
        self._may_run.acquire()

    def _run_to_end(self) -> None:
        self._may_run.acquire()
        try:
            self._run()
        finally:
            self.ended = True
            self._has_run.release()


class VirtualEvent(threading.Event):
    """An event whose `wait` lets virtual time pass."""

    def __init__(self, base: VirtualBase) -> None:
        super().__init__()
        self._base = base

    def wait(self, timeout: float | None = None) -> bool:
        assert timeout is not None
        self._base.sleep(timeout)
        return self.is_set()
