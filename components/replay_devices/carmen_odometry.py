"""Wheel odometry of a CARMEN log: what its poses mean, from ODOM lines and from laser records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.replay_devices.carmen_lines import LaserLine, OdometryLine
from cairn.planar.poses import Pose, compose, distance, inverse, relative, wrap, wrap_all

Array = NDArray[np.float64]

_NEAR_M, _NEAR_RAD = 0.01, 0.01  # median difference of poses that are the same
# Odometry may be stamped so much earlier or later than a scan of the same moment [s]: in the log of
# the Intel lab up to 0.3 s. At 0.5 m/s, half a step is half of _NEAR_M.
_SHIFT_S, _SHIFT_STEP_S = 0.5, 0.02
# An ODOM line closer than this to a scan [ns] adds nothing to the scan's own pose but noise.
_BESIDE_NS = SECOND // 100
# An ODOM line contradicts the poses around it if it leads off the way between them by more than
# this: a curve of 90 degrees is 8 % longer than its chords. In more than _SHORT_NS the robot may
# have turned or come back. It also contradicts them if it takes more than the highest speed at
# scans, with a margin for the jitter of time.
_CURVED, _OFF_M, _OFF_RAD, _SHORT_NS = 1.1, 0.01, 0.02, SECOND // 2
_FASTER, _FASTER_M_S, _FASTER_RAD_S = 1.5, 0.1, 0.2
_MOVING_M_S = 0.02  # a slower robot may stand
_UNSET_SHARE = 0.2  # of the lines whose times were not set, so many are more than a second off
_ENOUGH_LINES = 20  # odometry lines that decide whether a log counts backwards as forward


@dataclass(frozen=True)
class RejoinedOdometry:
    """Odometry lines without those that measured nothing, and the number of these."""

    lines: list[OdometryLine]
    anchors: int


def rejoin_increments(
    odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine]
) -> RejoinedOdometry:
    """Return raw odometry from lines that restart at each scan's corrected pose.

    GMapping writes such logs: a scan is followed by an ODOM line that repeats the scan's corrected
    pose, and the next lines continue from there. Such a line measures nothing, and its time is not
    set. Only the increments are measured; they are added up. Lines of other logs, in which fewer
    than half of the scans are followed by such a line, are returned unchanged.
    """
    records: list[OdometryLine | LaserLine] = [*odometry, *lasers]
    after: dict[int, LaserLine] = {}  # the scan right before a line
    scan: LaserLine | None = None
    for one in sorted(records, key=lambda one: one.line):
        if isinstance(one, LaserLine):
            scan = one
        elif scan is not None:
            after[one.line], scan = scan, None
    same = [line for line in odometry if line.line in after and line.pose == after[line.line].robot]
    # In a raw log such a line has the time of a robot that stands.
    unset = sum(abs(line.stamp - after[line.line].stamp) > SECOND for line in same)
    if not same or 2 * len(same) < len(lasers) or unset < _UNSET_SHARE * len(same):
        return RejoinedOdometry(list(odometry), 0)
    anchors = {line.line for line in same}
    lines: list[OdometryLine] = []
    to_raw: Pose = (0.0, 0.0, 0.0)
    for line in odometry:
        if line.line not in anchors:
            lines.append(replace(line, pose=compose(to_raw, line.pose)))
        elif lines:
            to_raw = compose(lines[-1].pose, inverse(line.pose))
    return RejoinedOdometry(lines, len(anchors))


@dataclass(frozen=True)
class RestoredOdometry:
    """Odometry lines with the direction of driving corrected, and the distance corrected [m]."""

    lines: list[OdometryLine]
    wrong_m: float


def restore_driving_direction(odometry: Sequence[OdometryLine]) -> RestoredOdometry:
    """Restore driving backwards in odometry that counted all distances as forward.

    Some bases did so, though their velocities have the right sign; so each increment gets the sign
    of its velocity. Lines of other logs are returned unchanged.
    """
    lines = list(odometry)
    backwards = [k for k in range(1, len(lines)) if lines[k].forward < -_MOVING_M_S]
    steps = [relative(a.pose, b.pose) for a, b in pairwise(lines)]
    forward = sum(steps[k - 1][0] > 0 for k in backwards)
    if len(backwards) < _ENOUGH_LINES or forward < 0.8 * len(backwards):
        return RestoredOdometry(lines, 0.0)
    pose = lines[0].pose
    for k, (x, y, theta) in enumerate(steps, start=1):
        sign = -1.0 if lines[k].forward < 0 else 1.0
        pose = compose(pose, (sign * x, sign * y, theta))
        lines[k] = replace(lines[k], pose=pose)
    return RestoredOdometry(lines, sum(abs(steps[k - 1][0]) for k in backwards))


def corrected_poses(
    odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine], anchors: int
) -> Array | None:
    """Return the robot's corrected poses (n, 3) at the scans, None if the log has only odometry.

    A scan's pose is corrected where it differs from the odometry around that time, or where the
    laser's pose moves against the robot's, which some programs leave raw; or where odometry was set
    to it (`anchors`).
    """
    if not lasers or any(line.laser is None or line.robot is None for line in lasers):
        return None
    laser = np.array([line.laser for line in lasers])
    robot = np.array([line.robot for line in lasers])
    mounts = _relative(robot, laser)
    if not _close(mounts, np.broadcast_to(np.median(mounts, axis=0), mounts.shape)):
        return laser
    if anchors:
        return robot
    if len(odometry) < 2:
        return None
    return None if _on_the_way(odometry, lasers, robot) else robot


def _on_the_way(
    odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine], robot: Array
) -> bool:
    """Return whether most poses (n, 3) at scans are those of the odometry around that time."""
    origin = odometry[0].stamp
    times = np.array([line.stamp - origin for line in odometry]) / SECOND
    poses = np.array([line.pose for line in odometry])
    headings = np.unwrap(poses[:, 2])
    scan_times = np.array([line.stamp - origin for line in lasers]) / SECOND
    least = np.full(len(lasers), np.inf)
    for shift in np.arange(-_SHIFT_S, _SHIFT_S + 1e-9, _SHIFT_STEP_S):
        x = np.interp(scan_times + shift, times, poses[:, 0])
        y = np.interp(scan_times + shift, times, poses[:, 1])
        theta = np.interp(scan_times + shift, times, headings)
        apart = np.hypot(x - robot[:, 0], y - robot[:, 1]) / _NEAR_M
        turned = np.abs(wrap_all(theta - robot[:, 2])) / _NEAR_RAD
        np.minimum(least, np.maximum(apart, turned), out=least)
    return bool(np.median(least) < 1.0)


@dataclass(frozen=True)
class MergedOdometry:
    """Odometry in temporal order, and how many ODOM lines were left out as contradicting."""

    lines: list[OdometryLine]
    contradicting: int


def with_poses_at_scans(
    odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine]
) -> MergedOdometry:
    """Return the raw poses in laser records, and those ODOM lines that agree with them.

    Both must be in temporal order. A laser record has the pose that belongs to its scan; the times
    of ODOM lines may be worse. An ODOM line agrees if the robot can have passed its pose on the way
    between the scans around it, at speeds that it drove at between scans.
    """
    at_scans = [_at_scan(line, velocity) for line, velocity in _velocities(odometry, lasers)]
    if not at_scans:
        return MergedOdometry(list(odometry), 0)
    limits = _speed_limits(at_scans)
    merged: list[OdometryLine] = []
    contradicting = 0
    place = 0
    for line in odometry:
        while place < len(at_scans) and at_scans[place].stamp <= line.stamp:
            merged.append(at_scans[place])
            place += 1
        around = at_scans[max(place - 1, 0) : place + 1]
        if any(abs(scan.stamp - line.stamp) < _BESIDE_NS for scan in around):
            continue
        before = merged[-1] if merged else None
        after = at_scans[place] if place < len(at_scans) else None
        if _contradicts(line, before, after, limits):
            contradicting += 1
        else:
            merged.append(line)
    return MergedOdometry([*merged, *at_scans[place:]], contradicting)


def _at_scan(line: LaserLine, velocity: tuple[float, float]) -> OdometryLine:
    assert line.robot is not None  # else the record has no odometry
    return OdometryLine(line.stamp, line.robot, *velocity, line.line, line.logger_s)


def _velocities(
    odometry: Sequence[OdometryLine], lasers: Sequence[LaserLine]
) -> list[tuple[LaserLine, tuple[float, float]]]:
    """Return the velocities at scans: the records' own, else those of the ODOM lines around."""
    if not odometry or any(line.velocity not in (None, (0.0, 0.0)) for line in lasers):
        return [(line, line.velocity or (0.0, 0.0)) for line in lasers]
    origin = odometry[0].stamp
    times = np.array([line.stamp - origin for line in odometry], dtype=np.float64)
    scan_times = np.array([line.stamp - origin for line in lasers], dtype=np.float64)
    forward = np.interp(scan_times, times, [line.forward for line in odometry]).tolist()
    turn = np.interp(scan_times, times, [line.turn for line in odometry]).tolist()
    return list(zip(lasers, zip(forward, turn, strict=True), strict=True))


def _speed_limits(lines: Sequence[OdometryLine]) -> tuple[float, float]:
    """Return speeds [m/s, rad/s] that the robot does not exceed, from its steps between scans."""
    poses = np.array([line.pose for line in lines])
    times: Array = np.array([line.stamp - lines[0].stamp for line in lines]) / SECOND
    seconds: Array = times[1:] - times[:-1]
    steps = np.diff(poses, axis=0)
    timed = seconds > 5 * _BESIDE_NS / SECOND  # shorter intervals are mostly jitter
    if not timed.any():
        return np.inf, np.inf
    speeds = np.hypot(steps[:, 0], steps[:, 1])[timed] / seconds[timed]
    turns = np.abs(wrap_all(steps[:, 2]))[timed] / seconds[timed]
    return (
        _FASTER * float(np.percentile(speeds, 99)) + _FASTER_M_S,
        _FASTER * float(np.percentile(turns, 99)) + _FASTER_RAD_S,
    )


def _contradicts(
    line: OdometryLine,
    before: OdometryLine | None,
    after: OdometryLine | None,
    limits: tuple[float, float],
) -> bool:
    moved = [0.0, 0.0]
    for other in (before, after):
        if other is None:
            continue
        seconds = abs(line.stamp - other.stamp) / SECOND
        step = (distance(line.pose, other.pose), abs(wrap(line.pose[2] - other.pose[2])))
        if step[0] > limits[0] * seconds + _OFF_M or step[1] > limits[1] * seconds + _OFF_RAD:
            return True
        moved = [moved[0] + step[0], moved[1] + step[1]]
    if before is None or after is None or after.stamp - before.stamp > _SHORT_NS:
        return False
    way = distance(before.pose, after.pose), abs(wrap(before.pose[2] - after.pose[2]))
    return moved[0] > _CURVED * way[0] + _OFF_M or moved[1] > _CURVED * way[1] + _OFF_RAD


def median_mount(lasers: Sequence[LaserLine]) -> Pose | None:
    """Return the laser's usual pose on the robot; None if the records do not determine one."""
    if not lasers or any(line.laser is None or line.robot is None for line in lasers):
        return None
    mounts = _relative(
        np.array([line.robot for line in lasers]), np.array([line.laser for line in lasers])
    )
    median = np.median(mounts, axis=0)
    if not _close(mounts, np.broadcast_to(median, mounts.shape)):
        return None
    x, y, theta = (0.0 + median.round(4)).tolist()  # logs have four decimals or more; no -0
    return x, y, theta


def _relative(origins: Array, poses: Array) -> Array:
    pairs = zip(origins.tolist(), poses.tolist(), strict=True)
    return np.array([relative(tuple(origin), tuple(pose)) for origin, pose in pairs])


def _close(some: Array, others: Array) -> bool:
    """Return whether most poses (n, 3) are the same."""
    apart = np.hypot(some[:, 0] - others[:, 0], some[:, 1] - others[:, 1])
    turned = np.abs(wrap_all(some[:, 2] - others[:, 2]))
    return bool(np.median(apart) < _NEAR_M and np.median(turned) < _NEAR_RAD)
