"""The command that the wheels are to carry out, as long as it is fresh."""

from __future__ import annotations

import math

from cairn.components.roboclaw.kinematics import Pair

STILL: Pair = (0.0, 0.0)


class LatestCommand:
    """Holds the newest command. One thread may give what another one takes."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._given: tuple[float, Pair] | None = None
        self._doubted_until = -math.inf

    def give(self, now: float, forward: float, turn: float) -> None:
        """Take a command [m/s, rad/s] at time `now` [s]."""
        self._given = (now, (forward, turn))

    def doubt(self, now: float) -> None:
        """Believe no command for a while: this process was held up, and what comes now has waited.

        Commands bear no time of their own.
        """
        self._doubted_until = now + self._timeout_s

    def forget(self) -> None:
        """Have none."""
        self._given = None

    def take(self, now: float) -> Pair:
        """What to do at time `now` [s]: the command, or to stand still once it is stale."""
        given = self._given
        if given is None or now - given[0] > self._timeout_s or given[0] < self._doubted_until:
            return STILL
        return given[1]
