"""The last poses that odometry told, and where the robot was between them."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from enum import Enum, auto

from cairn.planar.poses import Pose, apart, between, compose, inverse

# Drivers that stamp from several threads, or in batches, mix up a period or two of their 20 Hz or
# more; for no longer than this [ns] a robot stands still in its history when time is set back.
_DISORDER_NS = 100_000_000
# Time stamps jitter, and a step may look longer than it was by so much [m], [rad].
_GRACE_M, _GRACE_RAD = 0.1, 0.15
# In a gap the wheels drive on for no longer than that [s]: their driver has died, or says nothing.
_DRIVES_ON_S = 0.5


def began_anew(newest: int, stamp: int) -> bool:
    """Whether time was set back, if `stamp` [ns] comes after `newest`; else it is mere disorder."""
    return stamp < newest - _DISORDER_NS


def jumped(before: Pose, after: Pose, seconds: float, fastest: float, fastest_turn: float) -> bool:
    """Whether no wheels make that step in that time, if they do `fastest` [m/s] and [rad/s].

    A driver that is started anew counts from its origin again, and is silent before.
    """
    driven_s = min(seconds, _DRIVES_ON_S)
    return apart(before, after, fastest * driven_s + _GRACE_M, fastest_turn * driven_s + _GRACE_RAD)


class Added(Enum):
    """What became of a pose that an `OdometryHistory` was given."""

    IN_ORDER = auto()
    IGNORED = auto()
    """It is a little older than the newest one."""
    ANEW = auto()
    """Time was set back: it is the first one now, all before is forgotten."""


class OdometryHistory:
    """Poses in the odometry frame by time [ns], those of the last seconds."""

    def __init__(self, horizon_ns: int) -> None:
        self._horizon = horizon_ns
        self._stamps: deque[int] = deque()
        self._poses: deque[Pose] = deque()

    @property
    def newest(self) -> int | None:
        """Time [ns] of the newest pose, None before the first."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp: int, pose: Pose) -> Added:
        """Take a pose, unless it is a little older than the newest one.

        One that is much older tells that time began anew, and so does the history.
        """
        added = Added.IN_ORDER
        if self._stamps and stamp < self._stamps[-1]:
            if not began_anew(self._stamps[-1], stamp):
                return Added.IGNORED
            self.clear()
            added = Added.ANEW
        self._stamps.append(stamp)
        self._poses.append(pose)
        while len(self._stamps) > 2 and self._stamps[0] < stamp - self._horizon:
            self._stamps.popleft()
            self._poses.popleft()
        return added

    def at(self, stamp: int) -> Pose | None:
        """The pose at a time, between two of them in proportion; None before the oldest.

        After the newest it is that one: what is not told yet is not guessed.
        """
        index = bisect_right(self._stamps, stamp)
        if index == 0:
            return None
        if index == len(self._stamps):
            return self._poses[-1]
        before, after = self._stamps[index - 1], self._stamps[index]
        share = (stamp - before) / (after - before)
        return between(self._poses[index - 1], self._poses[index], share)

    def carried(self, pose: Pose, since: int, to: int) -> Pose | None:
        """Where a robot is at `to` that was at `pose` (any frame) at `since`; None if unknown."""
        left, reached = self.at(since), self.at(to)
        if left is None or reached is None:
            return None
        return compose(pose, compose(inverse(left), reached))

    def clear(self) -> None:
        """Forget all, as when odometry begins anew."""
        self._stamps.clear()
        self._poses.clear()
