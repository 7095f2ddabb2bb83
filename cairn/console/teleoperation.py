"""Teleoperation for a browser, by the operator's lease of the robot's velocity gate."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Final

import zenoh

from cairn.errors import CairnError
from cairn.system.clock import SECOND

STOP_AFTER_NS: Final = SECOND // 5
"""The robot is stopped when no command has arrived for so long; the gate itself waits 0.3 s."""

LATEST_NS: Final = SECOND // 2
"""A command is refused if what its browser last heard is older: the link, or the page, is late."""

END_AFTER_NS: Final = 3 * SECOND
"""Without a command for so long, the gate's lease is released, and the navigator may drive."""

_RELEASE_LIMIT_S: Final = 5.0  # of a request to the gate

Velocity = tuple[float, float]
STILL: Final[Velocity] = (0.0, 0.0)

Drive = Callable[[float, float], None]
"""Sends a speed [m/s] and a turn rate [rad/s] to the velocity gate, for 0.3 s."""


class DeadMan:
    """Decides what to send to the gate, from commands and their times [ns]. No threads.

    Each command carries the stamp of the last answer that the browser has received, so commands
    that were held up on the way, however long, are recognized without comparing clocks.
    """

    def __init__(self, now: int) -> None:
        self._heard_at = self._began = now
        self._wanted: Velocity | None = None  # not sent yet
        self._moves = False

    def stamp(self, now: int) -> int:
        """Return the stamp that the next command has to carry [ns]."""
        return now - self._began

    def command(self, now: int, stamp: int | None, velocity: Velocity) -> bool:
        """Take a command; return whether it counts. One without a stamp only announces others."""
        if stamp is None:
            self._heard_at = now
            return False
        if not 0 <= now - self._began - stamp <= LATEST_NS:
            return False
        self._heard_at = now
        self._wanted = velocity
        return True

    def take(self, now: int) -> Velocity | None:
        """Return what is to be sent now, None if nothing is."""
        if now - self._heard_at >= STOP_AFTER_NS:
            self._wanted = None
            stops, self._moves = self._moves, False
            return STILL if stops else None
        wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self._moves = wanted != STILL
        return wanted

    def wait_ns(self, now: int) -> int:
        """Return after which time something is to be done without a further command."""
        limit = STOP_AFTER_NS if self._moves else END_AFTER_NS
        return max(0, limit - (now - self._heard_at))

    def is_over(self, now: int) -> bool:
        """Return whether the browser has stopped driving."""
        return now - self._heard_at >= END_AFTER_NS


class Driver:
    """Drives a robot for one operator, on a thread of its own, until the commands cease.

    `command` and `end` do not wait. `operator_id` is the number of the operator's connection.
    """

    def __init__(
        self,
        operator_id: int,
        acquire: Callable[[], AbstractContextManager[Drive]],
        before: Driver | None = None,
        now: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Start to acquire the gate's lease by `acquire`; the end of its context releases it.

        `before` is the driver that had it before, and has been ended.
        """
        self.operator_id = operator_id
        self._acquire = acquire
        self._before = before
        self._now = now
        self._dead_man = DeadMan(now())
        self._changed = threading.Condition()
        self.is_ready = False  # whether it has the gate's lease
        self._ending = self._ended = False
        self._error = ""
        self._thread = threading.Thread(target=self._run, name="cairn drive", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        """Whether it drives no longer."""
        return self._ending or self._ended

    def wait(self, timeout_s: float) -> None:
        """Wait until the gate's lease is acquired; `CairnError` says why it cannot be."""
        with self._changed:
            ready = self._changed.wait_for(lambda: self.is_ready or self._ended, timeout_s)
            if self._error:
                raise CairnError(self._error)
            if not ready:
                raise CairnError(f"the velocity gate has not answered within {timeout_s:g} s")

    def command(self, stamp: int | None, velocity: Velocity) -> int | None:
        """Drive on; return the stamp for the next command, None if driving has ended.

        Raises `CairnError` with the reason if it has ended by an error.
        """
        with self._changed:
            if self._error:
                raise CairnError(self._error)
            if self._ending or self._ended:
                return None
            now = self._now()
            self._dead_man.command(now, stamp, velocity)
            self._changed.notify_all()
            return self._dead_man.stamp(now)

    def end(self) -> None:
        """Stop the robot at once, then release the gate's lease."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()

    def join(self, timeout_s: float) -> None:
        """Wait until the robot is stopped and the lease released."""
        self._thread.join(timeout_s)

    def _run(self) -> None:
        before, self._before = self._before, None
        try:
            if before is not None:
                before.join(_RELEASE_LIMIT_S)
            with self._acquire() as drive:
                with self._changed:
                    self.is_ready = True
                    self._changed.notify_all()
                try:
                    while (velocity := self._next()) is not None:
                        drive(*velocity)
                finally:
                    with suppress(CairnError, zenoh.ZError):
                        drive(*STILL)  # the base brakes before the request arrives at the gate
        except (CairnError, zenoh.ZError) as error:
            self._error = str(error)
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _next(self) -> Velocity | None:
        """Wait for what is to be sent next; None when driving is over."""
        with self._changed:
            while not self._ending:
                now = self._now()
                if (velocity := self._dead_man.take(now)) is not None:
                    return velocity
                if self._dead_man.is_over(now):
                    self._ending = True
                else:
                    self._changed.wait(self._dead_man.wait_ns(now) / SECOND)
            return None
