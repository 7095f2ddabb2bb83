"""Command timeout of bases: the newest velocity command, until it is stale."""

from __future__ import annotations

import math

Velocity = tuple[float, float]
"""Forward [m/s] and turn rate [rad/s]."""

REST: Velocity = (0.0, 0.0)


class LatestCommand:
    """Holds the newest velocity command. One thread sets it, the same or another one reads it."""

    def __init__(self, timeout_s: float) -> None:
        """`timeout_s`: the age at which a command is stale."""
        self._timeout_s = timeout_s
        self._latest: tuple[float, Velocity] | None = None
        self._ignored_until = -math.inf

    def set(self, now: float, forward: float, turn: float) -> None:
        """Set the command [m/s, rad/s], received at time `now` [s]."""
        self._latest = (now, (forward, turn))

    def ignore_queued(self, now: float) -> None:
        """Ignore commands for one timeout: this process was held up, and those were queued.

        Commands carry no time stamp of their own, so their age is unknown.
        """
        self._ignored_until = now + self._timeout_s

    def clear(self) -> None:
        """Remove the command."""
        self._latest = None

    def fresh(self, now: float) -> Velocity | None:
        """Return the command to execute at time `now` [s]; None if there is no fresh one.

        A command may arrive a moment after the reader took the time. One that is later by more than
        the timeout is stale: the clock was set back.
        """
        latest = self._latest
        if latest is None or latest[0] < self._ignored_until:
            return None
        return latest[1] if abs(now - latest[0]) <= self._timeout_s else None
