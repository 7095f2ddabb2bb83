"""Laser scans as points and rays around the robot, also while it moves during the sweep."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, inverse
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]

SURE_SHARE: Final = 0.35
"""Up to this share of the reach even dark surfaces return a ray. Chosen by hand."""

# A scan is uninformative if less than this share of its rays measures anything; single beams fail.
_LEAST_INFORMATIVE = 0.1


@dataclass(frozen=True)
class ScanBeams:
    """The beams of one scan in the frame of the robot's base.

    `start` is the scanner's pose on the robot; `angles` (n,) [rad] are directions in the base's
    frame; `ranges` (n,) [m]: finite where something was hit, +inf where nothing was hit within
    `reach` [m], NaN where the beam measured nothing.
    """

    start: Pose
    angles: Array
    ranges: Array
    reach: float

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Which beams (n,) hit something."""
        return np.isfinite(self.ranges)

    def points(self) -> Array:
        """Return x, y (m, 2) [m] of the hits in the base's frame."""
        ranges = self.ranges[self.hit]
        angles = self.angles[self.hit]
        x = self.start[0] + ranges * np.cos(angles)
        y = self.start[1] + ranges * np.sin(angles)
        return np.column_stack((x, y))

    def rays(self, base: Pose) -> Rays:
        """Return the beams in the frame in which the base stood at `base` during the sweep."""
        starts = np.tile(np.array(self.start[:2]), (self.ranges.size, 1))
        return Rays(starts, self.angles, self.ranges, self.reach).placed(base)


@dataclass(frozen=True)
class Rays:
    """Rays of a scan, in the frame of the base at the end of the sweep, unless `placed` elsewhere.

    `starts` (n, 2) [m], directions `angles` (n,) [rad], `ranges` (n,) [m]: finite where something
    was hit, +inf where nothing was hit within `reach` [m], NaN where the ray measured nothing.
    """

    starts: Array
    angles: Array
    ranges: Array
    reach: float

    @property
    def informative(self) -> bool:
        """Whether at least a tenth of the rays measured anything."""
        known = int(np.count_nonzero(~np.isnan(self.ranges)))
        return known > 0 and known >= _LEAST_INFORMATIVE * self.ranges.size

    def points(self, within: float = math.inf) -> Array:
        """Return x, y (m, 2) [m] of the hits up to this range [m]."""
        hit = self.ranges < within
        ranges, angles = self.ranges[hit], self.angles[hit]
        points: Array = self.starts[hit].copy()
        points[:, 0] += ranges * np.cos(angles)
        points[:, 1] += ranges * np.sin(angles)
        return points

    def misses(self) -> tuple[Array, Array]:
        """Return starts and ends, x, y (m, 2) [m] each, of the rays without a hit within reach."""
        missed = np.isposinf(self.ranges)
        starts, angles = self.starts[missed], self.angles[missed]
        return starts, starts + self.reach * np.column_stack((np.cos(angles), np.sin(angles)))

    def placed(self, base: Pose) -> Rays:
        """Return the rays in the frame in which the base was at `base` when the sweep ended."""
        x, y, turn = base
        cosine, sine = math.cos(turn), math.sin(turn)
        starts = np.empty_like(self.starts)
        starts[:, 0] = x + cosine * self.starts[:, 0] - sine * self.starts[:, 1]
        starts[:, 1] = y + sine * self.starts[:, 0] + cosine * self.starts[:, 1]
        return Rays(starts, self.angles + turn, self.ranges, self.reach)


def beams_of(scan: LaserScan, mount: Pose) -> ScanBeams:
    """Return the beams of a scan by a scanner that is mounted at `mount` on the robot.

    As in REP 117, +inf means that nothing was hit within reach; a range at or above `range_max`
    counts as the same. -inf (too near), NaN, exactly 0 (as drivers older than REP 117 send), and
    other ranges outside the scanner's limits count as beams that measured nothing.
    """
    ranges = scan.ranges.astype(np.float64)
    with np.errstate(invalid="ignore"):
        ranges[(ranges < scan.range_min) | (ranges == 0.0)] = math.nan
        ranges[ranges >= scan.range_max] = math.inf
    steps = np.arange(ranges.size, dtype=np.float64)
    angles: Array = mount[2] + scan.angle_min + scan.angle_increment * steps
    return ScanBeams(mount, angles, ranges, float(scan.range_max))


def has_directions(scan: LaserScan) -> bool:
    """Return whether the beams of a scan have more than one direction, if there are several."""
    return scan.ranges.size < 2 or scan.angle_increment != 0.0


def sweep_s(scan: LaserScan) -> float:
    """Return the time [s] from the first to the last beam of a scan."""
    return max(0.0, scan.time_increment * (scan.ranges.size - 1))


def rays_of(scan: LaserScan, mount: Pose, moved: Pose) -> Rays:
    """Return the rays of a scan, each from the pose that the robot had at the ray's time.

    The scanner is mounted at `mount` on the robot. `moved` is the pose of the base at the last beam
    relative to its pose at the first one; between them it moved evenly.
    """
    beams = beams_of(scan, mount)
    count = beams.ranges.size
    # The pose of the base at each beam relative to its pose at the end of the sweep.
    back_x, back_y, back_turn = inverse(moved)
    share = np.linspace(1.0, 0.0, count) if scan.time_increment > 0 else np.zeros(count)
    turn = share * back_turn
    cosine, sine = np.cos(turn), np.sin(turn)
    starts = np.empty((count, 2))
    starts[:, 0] = share * back_x + cosine * mount[0] - sine * mount[1]
    starts[:, 1] = share * back_y + sine * mount[0] + cosine * mount[1]
    return Rays(starts, beams.angles + turn, beams.ranges, beams.reach)
