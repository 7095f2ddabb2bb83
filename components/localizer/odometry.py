"""What odometry says of the robot's motion, between any two times."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import replace
from typing import Protocol

from cairn.components.localizer.motion import Increment, step_of
from cairn.planar.odometry import jumped
from cairn.planar.poses import Pose, between, relative


class OdometryTrack(Protocol):
    """The motion as a function of time [s], taken up piece by piece."""

    latest: float
    integrated_to: float

    def append(self, stamp: float, pose: Pose, forward: float, turn: float) -> bool:
        """Take a record: pose in the odometry frame, velocities [m/s, rad/s]; False if too old."""
        ...

    def advance(self, stamp: float) -> Increment:
        """The motion from where it was last advanced to until `stamp` [s]."""
        ...

    def preview(self, stamp: float) -> Increment:
        """The motion that `advance(stamp)` would return, without taking it."""
        ...


class CommandedTrack:
    """Odometry whose velocities are commands, each held until the next one.

    The base carries a command given at t out from t + `lag_s` on, and performs the share
    `forward_gain`, `turn_gain` [1] of it. Over a gap longer than `gap_s` the pose tells instead.
    """

    def __init__(
        self, lag_s: float, forward_gain: float = 1.0, turn_gain: float = 1.0, gap_s: float = 1.5
    ) -> None:
        self.lag_s = lag_s
        self.forward_gain, self.turn_gain = forward_gain, turn_gain
        self.gap_s = gap_s
        self._pending: deque[tuple[float, float, float]] = deque()
        self._speed = (0.0, 0.0)
        self._pose: Pose = (0.0, 0.0, 0.0)
        self.integrated_to = -math.inf
        self.latest = -math.inf

    def append(self, stamp: float, pose: Pose, forward: float, turn: float) -> bool:
        """Take the command of time `stamp` [s]; False if it is older than the newest one."""
        if stamp < self.latest:
            return False
        if self.latest > -math.inf and stamp - self.latest > self.gap_s:
            gap = stamp - self.latest
            step = relative(self._pose, pose)
            ahead = math.copysign(math.hypot(step[0], step[1]), step[0])
            self._pending.append((self.latest + self.lag_s, ahead / gap, step[2] / gap))
        self.latest = stamp
        self._pose = pose
        self._pending.append((stamp + self.lag_s, forward, turn))
        return True

    def advance(self, stamp: float) -> Increment:
        """The motion performed from where it was last advanced to until `stamp` [s]."""
        increment, self._speed, taken = self._integrate(stamp)
        for _ in range(taken):
            self._pending.popleft()
        self.integrated_to = max(self.integrated_to, stamp)
        return increment

    def preview(self, stamp: float) -> Increment:
        """The motion `advance(stamp)` would return, without taking it."""
        return self._integrate(stamp)[0]

    def _integrate(self, stamp: float) -> tuple[Increment, tuple[float, float], int]:
        # Before the first command nothing is known to move.
        now = stamp if self.integrated_to == -math.inf else self.integrated_to
        forward, turn = self._speed
        ahead = turned = moving = 0.0
        taken = 0
        for begins, next_forward, next_turn in self._pending:
            if begins > stamp:
                break
            if begins > now:
                step = begins - now
                ahead += forward * step
                turned += turn * step
                if forward or turn:
                    moving += step
                now = begins
            forward, turn = next_forward, next_turn
            taken += 1
        if stamp > now:
            step = stamp - now
            ahead += forward * step
            turned += turn * step
            if forward or turn:
                moving += step
        performed = Increment(
            self.forward_gain * ahead, 0.0, self.turn_gain * turned, moving, measured=False
        )
        return performed, (forward, turn), taken


class MeasuredTrack:
    """Odometry whose poses the wheels measured; between two of them in proportion.

    A step that no wheels can make (faster than `fastest` [m/s] or `turning` [rad/s]) is a jump:
    odometry began anew or slipped. It is left out, and counted in `jumps`.
    """

    def __init__(self, fastest: float = 3.0, turning: float = 7.0) -> None:
        self.fastest, self.turning = fastest, turning
        self.jumps = 0
        self._stamps: deque[float] = deque()
        self._poses: deque[Pose] = deque()  # without the jumps
        self._raw: Pose = (0.0, 0.0, 0.0)
        self.integrated_to = -math.inf
        self.latest = -math.inf

    def append(self, stamp: float, pose: Pose, forward: float, turn: float) -> bool:  # noqa: ARG002
        """Take the pose measured at `stamp` [s]; False if it is older than the newest one."""
        if stamp < self.latest:
            return False
        if self._poses:
            step = relative(self._raw, pose)
            seconds = stamp - self.latest
            if jumped(self._raw, pose, seconds, self.fastest, self.turning):
                self.jumps += 1
                step = (0.0, 0.0, 0.0)
            here = self._poses[-1]
            cosine, sine = math.cos(here[2]), math.sin(here[2])
            x = here[0] + cosine * step[0] - sine * step[1]
            y = here[1] + sine * step[0] + cosine * step[1]
            self._poses.append((x, y, here[2] + step[2]))
        else:
            self._poses.append(pose)
        self._raw = pose
        self._stamps.append(stamp)
        self.latest = stamp
        return True

    def advance(self, stamp: float) -> Increment:
        """The motion from where it was last advanced to until `stamp` [s]."""
        increment = self.preview(stamp)
        self.integrated_to = max(self.integrated_to, stamp)
        while len(self._stamps) > 1 and self._stamps[1] <= self.integrated_to:
            self._stamps.popleft()
            self._poses.popleft()
        return increment

    def preview(self, stamp: float) -> Increment:
        """The motion `advance(stamp)` would return, without taking it."""
        if self.integrated_to == -math.inf or not self._stamps or stamp <= self.integrated_to:
            return Increment(0.0, 0.0, 0.0, 0.0)
        step = relative(self._at(self.integrated_to), self._at(stamp))
        increment = step_of(step)
        moving = stamp - self.integrated_to if increment.moving_s else 0.0
        return replace(increment, moving_s=moving)

    def _at(self, stamp: float) -> Pose:
        index = bisect_right(self._stamps, stamp)
        if index == 0:
            return self._poses[0]
        if index == len(self._stamps):
            return self._poses[-1]
        before, after = self._stamps[index - 1], self._stamps[index]
        share = (stamp - before) / (after - before)
        return between(self._poses[index - 1], self._poses[index], share)
