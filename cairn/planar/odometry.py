"""Odometry history: recent poses in the order of their times, with jumps and resets detected.

Odometry may arrive late, in bursts and out of order, as over a bad network or from a driver with
several threads. A late record is inserted at its place, so any order of arrival gives the same
history. It is never judged by the record that arrived before it, but by its neighbors in time.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from typing import Generic, TypeVar

from cairn.planar.poses import Pose, apart, between, compose, inverse, relative
from cairn.system.clock import SECOND

# A clock, or a stamp of a scan, older than the newest by no more than this [ns] is only out of
# order: drivers that stamp from several threads, or in batches, mix up a period or two of their 20
# Hz or more.
_DISORDER_NS = 100_000_000
# Tolerance for jitter of stamps: a step may appear longer than it was by this much [m], [rad].
_GRACE_M, _GRACE_RAD = 0.1, 0.15
# In a gap of odometry the wheels are assumed to turn for no longer than this [s]: their driver has
# died, or it has stopped them.
_DRIVING_S = 0.5

ODOMETRY_DISORDER_S = 0.5
"""A record that arrives after one whose stamp is newer by no more than this [s] is only late.

Measured with delays at random up to 0.3 s; the rest is reserve. After a reset of time by less than
this the history of a robot that stands still makes no progress for no longer than this.
"""

OUTDATED_IN_A_ROW = 5
"""After so many records in a row that contradict their neighbors, time was set back.

Single ones may be wrong. At 50 Hz these are the records of 0.1 s, at 10 Hz those of 0.5 s.
"""


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


@dataclass(frozen=True)
class WheelLimits:
    """The highest speeds that wheels can have, `speed` [m/s] and `turn` [rad/s]."""

    speed: float
    turn: float


FASTEST_WHEELS = WheelLimits(3.0, 7.0)
"""A faster step is a jump: motion control accepts limits of up to 3 m/s and 6 rad/s."""


class OdometryChange(Enum):
    """How a new pose of odometry relates to those before it."""

    CONTINUED = auto()
    """It is the newest one."""
    LATE = auto()
    """It is older than the newest one, and was inserted at its place."""
    OUTDATED = auto()
    """It was ignored: too old, or in contradiction to its neighbors, but no reset yet."""
    JUMPED = auto()
    """The wheels cannot have driven this distance in that time: odometry restarted elsewhere."""
    RESET = auto()
    """Time was set back: the history starts again with this pose."""


Stamp = TypeVar("Stamp", int, float)


class OdometryHistory(Generic[Stamp]):
    """Poses in the odometry frame of the last seconds, by time.

    Between two jumps lies an *era* with an odometry frame of its own. The newest era counts;
    earlier ones are kept only for their late records, and for `driven_at`.
    """

    def __init__(
        self,
        horizon: float,
        limits: WheelLimits | None = None,
        *,
        resets_after: int = 1,
        per_second: float = SECOND,
    ) -> None:
        """Keep the poses of the last `horizon`, in the unit of the stamps.

        Args:
            horizon: Infinite: keep all poses until `forget`.
            limits: A step that exceeds them is a jump. None: there are no jumps.
            resets_after: After so many records in a row that are too old, time was set back.
            per_second: Units of the stamps per second: nanoseconds by default.

        """
        self._horizon = horizon
        self._limits = limits
        self._resets_after = resets_after
        self._per_second = per_second
        self._disorder = ODOMETRY_DISORDER_S * per_second
        self._outdated = 0
        self._stamps: deque[Stamp] = deque()
        self._poses: deque[Pose] = deque()
        self._driven: deque[Pose] = deque()  # without the jumps
        self._era = 0  # index of the first record of the newest era
        self._restarted: Stamp | None = None

    @property
    def newest(self) -> Stamp | None:
        """Time of the newest pose; None before the first."""
        return self._stamps[-1] if self._stamps else None

    @property
    def restarted(self) -> Stamp | None:
        """Time of the first pose since the last jump or reset; None if there was none."""
        return self._restarted

    def add(self, stamp: Stamp, pose: Pose) -> OdometryChange:
        """Add a pose at its place in time.

        It is late if it is older than the newest one by up to `ODOMETRY_DISORDER_S`, and the wheels
        can have driven from the pose before it and to the one after it. If it is older, or if this
        is not so for `OUTDATED_IN_A_ROW` poses, time was set back, and the history starts again.
        """
        newest = self.newest
        if newest is None or stamp >= newest:
            self._outdated = 0
            return self._append(stamp, pose)
        is_too_old = stamp < newest - self._disorder
        if not is_too_old and self._insert(stamp, pose):
            self._outdated = 0
            return OdometryChange.LATE
        self._outdated += 1
        if self._outdated < (self._resets_after if is_too_old else OUTDATED_IN_A_ROW):
            return OdometryChange.OUTDATED
        before, driven = self._poses[-1], self._driven[-1]
        self.clear()
        self._append(stamp, pose)
        # How long ago that was is unknown: as long as a gap may be.
        if not self._jumps(before, pose, _DRIVING_S * self._per_second):
            driven = _moved(driven, relative(before, pose))
        self._driven[0] = driven
        self._restarted = stamp
        return OdometryChange.RESET

    def has(self, stamp: Stamp) -> bool:
        """Return whether there is a pose of exactly this time."""
        index = bisect_right(self._stamps, stamp)
        return index > 0 and self._stamps[index - 1] == stamp

    def at(self, stamp: Stamp) -> Pose | None:
        """Return the pose at a time, interpolated; None before the oldest since the last jump.

        After the newest time, return the newest pose, without extrapolation.
        """
        index = bisect_right(self._stamps, stamp)
        return None if index <= self._era else self._interpolated(self._poses, index, stamp)

    def driven_at(self, stamp: Stamp) -> Pose:
        """Return the pose at a time as if there had been no jumps; the oldest before that.

        When time is set back, it continues from the pose before. The history must not be empty.
        """
        index = bisect_right(self._stamps, stamp)
        return self._driven[0] if index == 0 else self._interpolated(self._driven, index, stamp)

    def carried(self, pose: Pose, since: Stamp, to: Stamp) -> Pose | None:
        """Return the pose at `to` of a robot that was at `pose` (any frame) at `since`, or None."""
        left, reached = self.at(since), self.at(to)
        if left is None or reached is None:
            return None
        return compose(pose, compose(inverse(left), reached))

    def forget(self, before: float) -> None:
        """Forget the poses that are not needed for times from `before` on."""
        while len(self._stamps) > 1 and self._stamps[1] <= before:
            self._drop_oldest()

    def clear(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._stamps.clear()
        self._poses.clear()
        self._driven.clear()
        self._era = self._outdated = 0

    def _append(self, stamp: Stamp, pose: Pose) -> OdometryChange:
        change = OdometryChange.CONTINUED
        if self._stamps and self._jumps(self._poses[-1], pose, stamp - self._stamps[-1]):
            change = OdometryChange.JUMPED
            self._era, self._restarted = len(self._stamps), stamp
        self._stamps.append(stamp)
        self._poses.append(pose)
        self._driven.append(pose)
        if len(self._stamps) > 1:
            self._drive_on_from(len(self._stamps) - 1)
        while len(self._stamps) > 2 and self._stamps[0] < stamp - self._horizon:
            self._drop_oldest()
        return change

    def _insert(self, stamp: Stamp, pose: Pose) -> bool:
        """Insert a pose older than the newest; return False if it contradicts its neighbors."""
        after = bisect_right(self._stamps, stamp)
        before = after - 1
        follows = before >= 0 and not self._jumps(
            self._poses[before], pose, stamp - self._stamps[before]
        )
        leads = not self._jumps(pose, self._poses[after], self._stamps[after] - stamp)
        apart_before = before >= 0 and self._jumps(
            self._poses[before], self._poses[after], self._stamps[after] - self._stamps[before]
        )
        if not (follows or leads if apart_before else leads and (follows or before < 0)):
            return False
        neighbor = before if follows else after
        driven = _moved(self._driven[neighbor], relative(self._poses[neighbor], pose))
        if after < self._era or (after == self._era and follows):
            self._era += 1
        elif after == self._era and self._restarted is not None:
            self._restarted = stamp
        self._stamps.insert(after, stamp)
        self._poses.insert(after, pose)
        self._driven.insert(after, driven)
        if apart_before:
            self._drive_on_from(after)
        return True

    def _drive_on_from(self, index: int) -> None:
        """Compute the poses without the jumps from record `index` > 0 on."""
        for k in range(index, len(self._stamps)):
            before, after = self._poses[k - 1], self._poses[k]
            driven = self._driven[k - 1]
            if not self._jumps(before, after, self._stamps[k] - self._stamps[k - 1]):
                driven = _moved(driven, relative(before, after))
            self._driven[k] = driven

    def _jumps(self, before: Pose, after: Pose, duration: float) -> bool:
        limits = self._limits
        if limits is None:
            return False
        return is_jump(before, after, duration / self._per_second, limits.speed, limits.turn)

    def _interpolated(self, poses: deque[Pose], index: int, stamp: Stamp) -> Pose:
        """Return the pose at a time that lies before that of record `index`."""
        if index == len(self._stamps):
            return poses[-1]
        before, after = self._stamps[index - 1], self._stamps[index]
        share = (stamp - before) / (after - before)
        return between(poses[index - 1], poses[index], share)

    def _drop_oldest(self) -> None:
        self._stamps.popleft()
        self._poses.popleft()
        self._driven.popleft()
        self._era = max(0, self._era - 1)


def _moved(pose: Pose, step: Pose) -> Pose:
    """Return the pose after a step, without wrapping its heading."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + cosine * step[0] - sine * step[1]
    y = pose[1] + sine * step[0] + cosine * step[1]
    return x, y, pose[2] + step[2]
