"""Odometry history: recent poses by time, with jumps and times that go back detected."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from enum import Enum, auto

from cairn.planar.poses import Pose, apart, between, compose, inverse

# A stamp older than the newest by no more than this [ns] is only out of order: drivers that stamp
# from several threads, or in batches, mix up a period or two of their 20 Hz or more. So after a
# reset of time the history stands still for no longer than this.
_DISORDER_NS = 100_000_000
# Tolerance for jitter of stamps: a step may appear longer than it was by this much [m], [rad].
_GRACE_M, _GRACE_RAD = 0.1, 0.15
# In a gap of odometry the wheels are assumed to turn for no longer than this [s]: their driver has
# died, or it has stopped them.
_DRIVING_S = 0.5


def time_went_back(newest: int, stamp: int) -> bool:
    """Return whether time was set back, if `stamp` [ns] arrives after `newest`."""
    return stamp < newest - _DISORDER_NS


def is_jump(before: Pose, after: Pose, seconds: float, fastest: float, fastest_turn: float) -> bool:
    """Return whether a step is impossible for wheels of at most `fastest` [m/s], [rad/s].

    That happens when a restarted driver counts from its origin again, after a gap.
    """
    driving_s = min(seconds, _DRIVING_S)
    return apart(
        before, after, fastest * driving_s + _GRACE_M, fastest_turn * driving_s + _GRACE_RAD
    )


class OdometryChange(Enum):
    """How a new pose of odometry relates to those before it."""

    CONTINUED = auto()
    OUTDATED = auto()
    """It is slightly older than the newest one, and ignored."""
    JUMPED = auto()
    """The wheels cannot have driven this distance in that time: odometry restarted elsewhere."""
    RESET = auto()
    """Time was set back."""


class OdometryHistory:
    """Poses in the odometry frame of the last seconds, by time [ns]."""

    def __init__(self, horizon_ns: int) -> None:
        self._horizon = horizon_ns
        self._stamps: deque[int] = deque()
        self._poses: deque[Pose] = deque()

    @property
    def newest(self) -> int | None:
        """Time [ns] of the newest pose; None before the first."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp: int, pose: Pose) -> OdometryChange:
        """Add a pose, unless it is slightly older than the newest one.

        A much older stamp means that time was set back: the history starts again with this pose.
        """
        change = OdometryChange.CONTINUED
        if self._stamps and stamp < self._stamps[-1]:
            if not time_went_back(self._stamps[-1], stamp):
                return OdometryChange.OUTDATED
            self.clear()
            change = OdometryChange.RESET
        self._stamps.append(stamp)
        self._poses.append(pose)
        while len(self._stamps) > 2 and self._stamps[0] < stamp - self._horizon:
            self._stamps.popleft()
            self._poses.popleft()
        return change

    def at(self, stamp: int) -> Pose | None:
        """Return the pose at a time, interpolated; None before the oldest.

        After the newest time, return the newest pose, without extrapolation.
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
        """Return the pose at `to` of a robot that was at `pose` (any frame) at `since`, or None."""
        left, reached = self.at(since), self.at(to)
        if left is None or reached is None:
            return None
        return compose(pose, compose(inverse(left), reached))

    def clear(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._stamps.clear()
        self._poses.clear()
