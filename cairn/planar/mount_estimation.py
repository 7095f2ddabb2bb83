"""Estimation of a scanner's yaw on the robot, from scans and odometry while it drives straight.

Two scans at both ends of a straight way overlap if the second one is shifted by the way as the
scanner saw it. Odometry has its length, and its direction on the robot; so what remains is the yaw
of the scanner. That yaw is best at which all pairs together overlap best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, relative, wrap, wrap_all
from cairn.planar.scans import beams_of
from cairn.schemas.sensor_msgs import LaserScan

if TYPE_CHECKING:
    from scipy.spatial import KDTree

Array = NDArray[np.float64]

# Ways between two scans: long enough to have a direction in spite of the noise of ranges, short
# enough that both see the same [m]; and how straight [rad], so that the scanner's position on the
# robot, up to 0.5 m off its center, moves it by less than 3 cm.
_SHORTEST_M, _LONGEST_M, _STRAIGHT_RAD = 0.3, 1.0, 0.06
_FEWEST_PAIRS, _MOST_PAIRS = 8, 40
# Turns on the spot between two scans: at most so much motion [m], and turns of at least, at most so
# much [rad].
_ON_THE_SPOT_M, _LEAST_TURN_RAD, _MOST_TURN_RAD = 0.2, 0.15, 0.8
_MOST_POINTS = 120  # of a scan that are compared with the surfaces of the other one
# Ends of beams beyond this are too far apart to be surfaces; points are compared up to a shorter
# range, so that they are on surfaces also after the way.
_REACH_M, _POINTS_M = 15.0, 10.0
_JOINED_M = 0.3  # ends of neighboring beams nearer than this are on one surface
_SPACING_M = 0.02  # of the points that stand for a surface
_FAR_M = 0.15  # points farther from all surfaces are of something that the other scan does not see
_COARSE_RAD, _FINE_RAD = math.radians(5.0), math.radians(1.0)
# Odometry veers by up to 0.02 rad per meter (fr079, fr101). Seen from the scanner, walls 5 m away
# then move sideways by as much as with a yaw 0.1 rad off; so turns that fit better are tried [rad].
_VEERED = np.linspace(-0.01, 0.01, 9)
_OTHER_RAD = math.radians(40.0)  # yaws that differ by more are other hypotheses
_SURE = 4.0  # standard errors by which the best yaw must be better than all others
_GROUPS = 8  # of pairs, each left out once for the uncertainty
_LEAST_DEVIATION, _MOST_DEVIATION = math.radians(0.5), math.radians(10.0)


@dataclass(frozen=True)
class MountYaw:
    """The scanner's yaw on the robot [rad, left positive], and its standard deviation [rad]."""

    yaw: float
    deviation: float


def estimate_mount_yaw(scans: Sequence[LaserScan], poses: Array) -> MountYaw | None:
    """Estimate the yaw of the scanner that took `scans` while odometry measured `poses`.

    Args:
        scans: scans in temporal order, of a scanner that is not upside down.
        poses: the pose in the odometry frame (n, 3) [m, m, rad] at each scan.

    Returns None if the motion does not determine the yaw: the robot did not drive straight often
    enough, or its surroundings look the same from elsewhere, as in a long corridor. The longest of
    recordings takes a few seconds: at most 40 pairs of scans are compared.
    """
    pairs = _straight_pairs(poses)
    if len(pairs) < _FEWEST_PAIRS:
        return None
    overlaps = [
        _Overlap.of(
            scans[first], scans[second], relative(_pose(poses, first), _pose(poses, second))
        )
        for first, second in pairs
    ]
    known = [overlap for overlap in overlaps if overlap is not None]
    if len(known) < _FEWEST_PAIRS:
        return None
    yaws: Array = np.arange(-math.pi, math.pi, _COARSE_RAD)
    costs = np.array([overlap.costs(yaws, np.zeros(1)) for overlap in known])
    best = int(np.argmin(costs.sum(axis=0)))
    for other in np.nonzero(np.abs(wrap_all(yaws - yaws[best])) > _OTHER_RAD)[0]:
        worse = costs[:, other] - costs[:, best]
        error = float(worse.std(ddof=1)) / math.sqrt(len(known))
        if worse.mean() < _SURE * error:
            return None
    fine: Array = yaws[best] + np.arange(-10, 11) * _FINE_RAD
    costs = np.array([overlap.costs(fine, _VEERED) for overlap in known])
    yaw = _least(fine, costs.sum(axis=0))
    groups = np.arange(len(known)) % _GROUPS
    partial = np.array([_least(fine, costs[groups != k].sum(axis=0)) for k in range(_GROUPS)])
    # The jackknife's standard error.
    deviation = math.sqrt((_GROUPS - 1) / _GROUPS * float(((partial - partial.mean()) ** 2).sum()))
    if deviation > _MOST_DEVIATION:
        return None
    return MountYaw(wrap(yaw), max(deviation, _LEAST_DEVIATION))


def seems_upside_down(scans: Sequence[LaserScan], poses: Array) -> bool:
    """Return whether the surroundings turn with the robot instead of against it.

    So a scanner sees them that is upside down, or whose beams are in the opposite order.

    Args:
        scans: scans in temporal order, as of a scanner that is not upside down.
        poses: the pose in the odometry frame (n, 3) [m, m, rad] at each scan.

    """
    better = []
    for first, second in _turning_pairs(poses):
        x, y, turn = relative(_pose(poses, first), _pose(poses, second))
        overlaps = [_Overlap.of(scans[first], scans[second], (x, y, one)) for one in (turn, -turn)]
        costs = [one.costs(np.zeros(1), _VEERED)[0] for one in overlaps if one is not None]
        if len(costs) == 2:
            better.append(costs[0] - costs[1])
    if len(better) < _FEWEST_PAIRS:
        return False
    error = float(np.std(better, ddof=1)) / math.sqrt(len(better))
    return float(np.mean(better)) > _SURE * error


def _turning_pairs(poses: Array) -> list[tuple[int, int]]:
    """Return pairs of indices between which the robot turned on the spot, evenly chosen."""
    pairs: list[tuple[int, int]] = []
    first = 0
    for second in range(1, len(poses)):
        x, y, turn = relative(_pose(poses, first), _pose(poses, second))
        if math.hypot(x, y) > _ON_THE_SPOT_M or abs(turn) > _MOST_TURN_RAD:
            first = second
        elif abs(turn) >= _LEAST_TURN_RAD:
            pairs.append((first, second))
            first = second
    return _some(pairs)


def _some(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    chosen = np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_PAIRS)).round().astype(int)
    return [pairs[k] for k in sorted(set(chosen.tolist()))]


def _straight_pairs(poses: Array) -> list[tuple[int, int]]:
    """Return pairs of indices between which the robot drove straight, evenly chosen."""
    pairs: list[tuple[int, int]] = []
    first = 0
    for second in range(1, len(poses)):
        x, y, _ = relative(_pose(poses, first), _pose(poses, second))
        turns = np.abs(wrap_all(poses[first : second + 1, 2] - poses[first, 2]))
        moved = math.hypot(x, y)
        if turns.max() > _STRAIGHT_RAD or moved > _LONGEST_M:
            first = second
        elif moved >= _SHORTEST_M:
            steps = np.diff(poses[first : second + 1, :2], axis=0)
            if moved > 0.95 * np.hypot(steps[:, 0], steps[:, 1]).sum():
                pairs.append((first, second))
            first = second
    return _some(pairs)


@dataclass(frozen=True)
class _Overlap:
    """Points (n, 2) of one scan, turned as the other one, whose surfaces are in `tree`.

    `way` (2,) [m] is the motion between both in the robot's frame. The other scan covers directions
    up to `half` [rad] from `middle` [rad]; what it did not look at is not compared.
    """

    tree: KDTree
    points: Array
    way: Array
    middle: float
    half: float

    @staticmethod
    def of(before: LaserScan, after: LaserScan, step: Pose) -> _Overlap | None:
        """Return how two scans overlap; None if one of them sees too little."""
        from scipy.spatial import KDTree  # takes 0.2 s: only when a mount is estimated

        surfaces, points = _surfaces(before), _ends(after, _POINTS_M)
        if len(surfaces) < 20 or len(points) < 20:
            return None
        points = points[:: max(1, len(points) // _MOST_POINTS)]
        middle = 0.5 * (before.angle_min + before.angle_max)
        half = 0.5 * abs(before.angle_max - before.angle_min)
        tree = KDTree(surfaces)
        return _Overlap(tree, _turned(points, step[2]), np.array(step[:2]), middle, half)

    def costs(self, yaws: Array, veered: Array) -> Array:
        """Return the mean distance [m] of the points from the surfaces for each of the yaws.

        It is the least one if odometry was wrong by one of the turns `veered` [rad].
        """
        x = np.cos(yaws) * self.way[0] + np.sin(yaws) * self.way[1]
        y = np.cos(yaws) * self.way[1] - np.sin(yaws) * self.way[0]
        ways = np.column_stack((x, y))[:, None]
        least = np.full(len(yaws), _FAR_M)
        for turn in veered.tolist():
            moved = _turned(self.points, turn)[None] + ways
            apart, _ = self.tree.query(moved, distance_upper_bound=_FAR_M)
            bearings = wrap_all(np.arctan2(moved[..., 1], moved[..., 0]) - self.middle)
            seen = np.abs(bearings) <= self.half
            total = (np.minimum(apart, _FAR_M) * seen).sum(axis=1)
            count = np.count_nonzero(seen, axis=1)
            enough = 2 * count > len(self.points)
            np.minimum(least, np.where(enough, total / np.maximum(count, 1), _FAR_M), out=least)
        return least


def _turned(points: Array, angle: float) -> Array:
    cosine, sine = math.cos(angle), math.sin(angle)
    turned: Array = points @ np.array([[cosine, sine], [-sine, cosine]])
    return turned


def _ends(scan: LaserScan, reach: float) -> Array:
    """Return the ends (n, 2) [m] of beams up to `reach` [m] in the scanner's frame."""
    beams = beams_of(scan, (0.0, 0.0, 0.0))
    with np.errstate(invalid="ignore"):
        near = beams.ranges < reach
    ranges, angles = beams.ranges[near], beams.angles[near]
    return np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles)))


def _surfaces(scan: LaserScan) -> Array:
    """Return points (n, 2) [m] close together on the surfaces that a scan saw."""
    ends = _ends(scan, _REACH_M)
    gaps = np.hypot(*np.diff(ends, axis=0).T)
    pieces = [ends]
    for k in np.nonzero((gaps > _SPACING_M) & (gaps < _JOINED_M))[0]:
        shares = np.arange(_SPACING_M, gaps[k], _SPACING_M)[:, None] / gaps[k]
        pieces.append(ends[k] + shares * (ends[k + 1] - ends[k]))
    return np.concatenate(pieces)


def _least(yaws: Array, costs: Array) -> float:
    """Return the yaw [rad] of the least cost, between the given ones by a parabola."""
    k = min(max(int(np.argmin(costs)), 1), len(yaws) - 2)
    before, at, after = costs[k - 1 : k + 2].tolist()
    curved = before - 2.0 * at + after
    offset = 0.5 * (before - after) / curved if curved > 0 else 0.0
    return float(yaws[k] + max(-1.0, min(1.0, offset)) * (yaws[1] - yaws[0]))


def _pose(poses: Array, index: int) -> Pose:
    x, y, theta = poses[index].tolist()
    return x, y, theta
