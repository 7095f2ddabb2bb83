"""Finds out what a CARMEN log's poses mean: raw odometry, corrected poses, or a mixture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cairn.components.replay.carmen_lines import LaserLine, OdometryLine
from cairn.planar.poses import Pose, compose, inverse, relative, wrap_all

Array = NDArray[np.float64]

_NEAR_M, _NEAR_RAD = 0.01, 0.01  # by which poses of one thing may differ in the middle of a log
_MOVING_M_S = 0.02  # what is slower may stand
_ENOUGH = 20  # odometry lines that settle how a log counts


@dataclass(frozen=True)
class Chained:
    """Odometry lines without those that measured nothing, and how many these were."""

    lines: list[OdometryLine]
    anchors: int


def chained(odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine]) -> Chained:
    """Raw odometry out of lines that begin anew at each scan's corrected pose.

    GMapping writes its logs so: after a scan follows an ODOM line without a time of its own that
    repeats the scan's corrected pose, and the lines after it go on from there. Only the
    increments are measured; they are added up. Lines of other logs come back as they are.
    """
    scans = {line.line: line for line in lasers}
    at = sorted([*(line.line for line in odometry), *scans])
    by_line = {line.line: line for line in odometry}
    lines: list[OdometryLine] = []
    to_raw: Pose = (0.0, 0.0, 0.0)
    scan: LaserLine | None = None
    anchors = 0
    for number in at:
        if number in scans:
            scan = scans[number]
            continue
        line = by_line[number]
        if scan is not None and line.pose == scan.robot and line.time < scan.time - 1.0:
            anchors += 1
            if lines:
                to_raw = compose(lines[-1].pose, inverse(line.pose))
        else:
            pose = compose(to_raw, line.pose) if anchors else line.pose
            lines.append(replace(line, pose=pose))
        scan = None
    return Chained(lines, anchors)


@dataclass(frozen=True)
class Signed:
    """Odometry lines with the direction of driving put right, and the way that was wrong [m]."""

    lines: list[OdometryLine]
    wrong_m: float


def signed(odometry: Sequence[OdometryLine]) -> Signed:
    """Odometry that knows of driving backwards, out of one that counted all ways as ahead.

    Some bases did so, though the velocity beside the pose has the right sign; so each increment
    is given its sign. Lines of other logs come back as they are.
    """
    lines = list(odometry)
    backwards = [k for k in range(1, len(lines)) if lines[k].forward < -_MOVING_M_S]
    steps = [relative(a.pose, b.pose) for a, b in pairwise(lines)]
    ahead = sum(steps[k - 1][0] > 0 for k in backwards)
    if len(backwards) < _ENOUGH or ahead < 0.8 * len(backwards):
        return Signed(lines, 0.0)
    pose = lines[0].pose
    for k, (x, y, theta) in enumerate(steps, start=1):
        way = -1.0 if lines[k].forward < 0 else 1.0
        pose = compose(pose, (way * x, way * y, theta))
        lines[k] = replace(lines[k], pose=pose)
    return Signed(lines, sum(abs(steps[k - 1][0]) for k in backwards))


def corrected(odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine]) -> Array | None:
    """The robot's corrected poses (n, 3) at the scans, None if the log has only odometry.

    A scan's pose is corrected where it differs from what the wheels told at that time, or where
    the laser's pose moves against the robot's, which some programs leave raw.
    """
    if not lasers or any(line.laser is None or line.robot is None for line in lasers):
        return None
    laser = np.array([line.laser for line in lasers])
    robot = np.array([line.robot for line in lasers])
    mounts = _relative(robot, laser)
    if not _close(mounts, np.broadcast_to(np.median(mounts, axis=0), mounts.shape)):
        return laser
    if len(odometry) < 2:
        return None
    times = np.array([line.time for line in odometry])
    poses = np.array([line.pose for line in odometry])
    scan_times = np.array([line.time for line in lasers])
    wheels = np.column_stack(
        (
            np.interp(scan_times, times, poses[:, 0]),
            np.interp(scan_times, times, poses[:, 1]),
            np.interp(scan_times, times, np.unwrap(poses[:, 2])),
        )
    )
    return None if _close(wheels, robot) else robot


def _relative(origins: Array, poses: Array) -> Array:
    pairs = zip(origins.tolist(), poses.tolist(), strict=True)
    return np.array([relative(tuple(origin), tuple(pose)) for origin, pose in pairs])


def _close(some: Array, others: Array) -> bool:
    """Whether poses (n, 3) are the same for the most part."""
    apart = np.hypot(some[:, 0] - others[:, 0], some[:, 1] - others[:, 1])
    turned = np.abs(wrap_all(some[:, 2] - others[:, 2]))
    return bool(np.median(apart) < _NEAR_M and np.median(turned) < _NEAR_RAD)
