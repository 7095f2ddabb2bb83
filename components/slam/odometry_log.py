"""The odometry of a recording, calibrated: the robot's motion between any two times."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.planar.motion_model import MotionModel, OdometryStep, odometry_step
from cairn.planar.odometry import FASTEST_WHEELS, is_jump
from cairn.planar.pose_tracker import EXACT_S
from cairn.planar.poses import Pose, relative, wrap

Array = NDArray[np.float64]

LEAST_M, LEAST_RAD = 0.003, 0.002
"""Least deviations of a motion, in x and y [m], and heading [rad]."""


@dataclass(frozen=True)
class OdometryCalibration:
    """How the robot moves when odometry states a motion.

    Attributes:
        forward_gain: distance driven per distance of odometry [1].
        turn_gain: angle turned per angle of odometry [1].
        lag_s: how much later the robot moves than odometry states [s].
        veer: angle turned per distance of odometry [rad/m], besides.

    """

    forward_gain: float = 1.0
    turn_gain: float = 1.0
    lag_s: float = 0.0
    veer: float = 0.0

    def corrected(self, step: OdometryStep) -> OdometryStep:
        """Return a step of odometry as the robot moved, but for the lag."""
        return replace(
            step,
            ahead=self.forward_gain * step.ahead,
            aside=self.forward_gain * step.aside,
            turned=self.turn_gain * step.turned + self.veer * step.ahead,
        )


@dataclass(frozen=True)
class OdometryPath:
    """The calibrated poses of odometry by time.

    Attributes:
        origin_ns: when the odometry starts [ns].
        time: (n,) when the robot was at the poses [s] since `origin_ns`, increasing.
        poses: (n, 3) x, y [m] and heading [rad, not wrapped], each column contiguous: otherwise
            every interpolation would copy all of it.
        moving: (n,) time in motion up to then [s].

    """

    origin_ns: int
    time: Array
    poses: Array
    moving: Array

    def at(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Return the poses (n, 3) at some times; before and after the path its ends."""
        seconds = (stamps_ns - self.origin_ns) / SECOND
        return np.column_stack([np.interp(seconds, self.time, one) for one in self.poses.T])

    def motion(self, start_ns: int, end_ns: int, model: MotionModel) -> tuple[Pose, Array]:
        """Return the motion between two times, and its information (3, 3) in the final frame."""
        # When the wheels start or stop is known up to this; velocities are means over twice that.
        half = round(EXACT_S * SECOND)
        around = [start_ns - half, start_ns, start_ns + half, end_ns - half, end_ns, end_ns + half]
        poses = self.at(np.array(around))
        start, end = poses[1].tolist(), poses[4].tolist()
        (x, y, _), turn = relative(start, end), end[2] - start[2]
        seconds = (np.array([start_ns, end_ns]) - self.origin_ns) / SECOND
        moving = float(np.diff(np.interp(seconds, self.time, self.moving))[0])
        chord = odometry_step((x, y, turn))
        deviations = model.deviations(OdometryStep(chord.ahead, chord.aside, turn, moving))
        slower = poses[2] - poses[0] - (poses[5] - poses[3])
        ahead_sd = math.hypot(deviations[0], 0.5 * math.hypot(slower[0], slower[1]))
        turn_sd = math.hypot(deviations[2], 0.5 * slower[2])
        # A heading that errs by so much at the end has erred by half of it on the way.
        aside_sd = math.hypot(deviations[1], 0.5 * turn_sd * chord.ahead)
        ahead_sd = math.hypot(ahead_sd, 0.5 * turn_sd * chord.aside)
        variances = np.square([ahead_sd, aside_sd, turn_sd])
        variances += np.square([LEAST_M, LEAST_M, LEAST_RAD])
        cosine, sine = math.cos(0.5 * turn), math.sin(0.5 * turn)
        # From the middle heading to the final one.
        rotation = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        information: Array = rotation @ np.diag(1.0 / variances) @ rotation.T
        return (x, y, wrap(turn)), information


class OdometryLog:
    """The poses of odometry by time, without jumps."""

    def __init__(self) -> None:
        self._newest: Pose | None = None
        self._origin_ns = 0
        # Of each pose: time [s] from the first, and the step to it along its middle heading.
        self._time, self._ahead, self._aside, self._turned = (array("d") for _ in range(4))

    def add(self, stamp_ns: int, pose: Pose) -> None:
        """Add the pose of the base in the odometry frame at a time; an older one is ignored."""
        if self._newest is None:
            self._origin_ns = stamp_ns
            self._append(0.0, (0.0, 0.0, 0.0))
        else:
            seconds = (stamp_ns - self._origin_ns) / SECOND
            since = seconds - self._time[-1]
            if since <= 0.0:
                return
            fastest = FASTEST_WHEELS
            jumped = is_jump(self._newest, pose, since, fastest.speed, fastest.turn)
            self._append(seconds, (0.0, 0.0, 0.0) if jumped else relative(self._newest, pose))
        self._newest = pose

    def _append(self, seconds: float, moved: Pose) -> None:
        step = odometry_step(moved)
        self._time.append(seconds)
        self._ahead.append(step.ahead)
        self._aside.append(step.aside)
        self._turned.append(step.turned)

    def path(self, calibration: OdometryCalibration, since_ns: int | None = None) -> OdometryPath:
        """Return the calibrated path, from its start or from `since_ns` [ns] on."""
        first = 0
        if since_ns is not None:
            seconds = (since_ns - self._origin_ns) / SECOND - calibration.lag_s - 2 * EXACT_S
            first = max(0, int(np.searchsorted(np.frombuffer(self._time), seconds)) - 1)
        time, ahead, aside, turned = (
            np.array(values[first:])
            for values in (self._time, self._ahead, self._aside, self._turned)
        )
        turned = calibration.turn_gain * turned + calibration.veer * ahead
        theta = np.cumsum(turned)
        cosine, sine = np.cos(theta - 0.5 * turned), np.sin(theta - 0.5 * turned)
        x = calibration.forward_gain * np.cumsum(cosine * ahead - sine * aside)
        y = calibration.forward_gain * np.cumsum(sine * ahead + cosine * aside)
        is_moving = (ahead != 0.0) | (aside != 0.0) | (turned != 0.0)
        moving = np.cumsum(np.diff(time, prepend=time[0]) * is_moving)
        poses = np.stack((x, y, theta)).T
        return OdometryPath(self._origin_ns, time + calibration.lag_s, poses, moving)
