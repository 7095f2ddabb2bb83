"""Command timeout: the wheels stop once the newest velocity command is stale."""

from __future__ import annotations

import math

from cairn.components.roboclaw.kinematics import Pair

REST: Pair = (0.0, 0.0)


class LatestCommand:
    """Holds the newest velocity command. One thread sets it, another one reads it."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._latest: tuple[float, Pair] | None = None
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

    def current(self, now: float) -> Pair:
        """Return the command to execute at time `now` [s]; rest if there is no fresh one."""
        latest = self._latest
        if latest is None or now - latest[0] > self._timeout_s or latest[0] < self._ignored_until:
            return REST
        return latest[1]
