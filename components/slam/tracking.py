"""Tracks the robot by aligning each scan to the keyframes just before it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.alignment import Alignment, Reference
from cairn.components.slam.correlation import CorrelationMap
from cairn.components.slam.point_cloud import PointCloud
from cairn.components.slam.recent_surfaces import RecentSurfaces
from cairn.planar.poses import Pose, apart, compose
from cairn.planar.scans import Rays

Array = NDArray[np.float64]
Noise = tuple[tuple[float, float, float], tuple[float, float, float]]

# A scan with fewer points is not aligned: the robot is where odometry says.
_LEAST_POINTS = 20
# Wheels slip by at most so many of their standard deviations: 0.2 m or 0.3 rad in a tenth of a
# second. The robot does not jump.
_SLIPS = 3.0
# How far a pose may be from where odometry puts it, as standard deviations: of the position,
# constant [m], per meter, and per radian [m/rad]; of the heading, constant [rad], per radian, and
# per meter [rad/m]. If wheels slip, they turn the robot by tenths of a radian.
_NOISE: Noise = ((0.005, 0.05, 0.01), (0.003, 0.05, 0.02))
_SLIP: Noise = ((0.05, 0.3, 0.02), (0.1, 0.2, 0.05))
# A scan is aligned with so many times the noise first, as the noise of successive steps has a
# common sign.
_TRUSTED = 2.5
# Beyond that, the heading may be off by this [rad]: a scan that is stamped 0.1 s late shows a robot
# that turns by 0.5 rad/s. With it, the relations of fr079 are 0.43 deg off, without 0.48.
_STAMPED_LATE_RAD = 0.05
# Points are paired up to this distance at first [m]; less after a search.
_REACH_M, _REACH_AFTER_SEARCH_M = 0.4, 0.2
# A scan is searched for if it fits worse than this share of the usual fit, or if its pose is so far
# from where odometry puts it [m], [rad].
_POOR_FIT, _SURPRISE_M, _SURPRISE_RAD = 0.8, 0.1, 0.06
_FIT_MEMORY = 0.1  # share of the newest scan in the usual fit
# Least score of a searched pose. How much better a scan must fit for the wheels to have slipped,
# times the square root of the number of its points: few points fit by chance.
_LEAST_SCORE, _BETTER = 0.3, 2.0
# A slip must show in so many cells of surfaces of this size [m], 4 m of wall: a person fills three
# to five, a pillar five. The points of fewer cells share their errors: they say less.
_SURFACE_CELLS, _SURFACE_CELL_M = 16, 0.25
# Points of a search: one in this many meters, no farther than this [m].
_SEARCH_CELL, _SEARCH_REACH_M = 0.1, 15.0
# A scan that fits worse than this, or than this share of the usual fit, is not of this place, or
# people hide the place.
_NO_FIT, _NO_FIT_OF_USUAL = 0.3, 0.6
# The robot was moved if so many scans in a row fit nowhere, and each sees through this share of the
# surfaces, or has this share of its points where space was free while this share of its beams end.
# People hide surfaces, but hardly on all sides.
_MOVED_IN_A_ROW, _PASSED, _IN_FREE_SPACE, _ENCLOSED = 4, 0.25, 0.8, 0.6
# Points where space was free are people, if they are at most this share of those that are known.
_MOST_MOVING = 0.5


@dataclass(frozen=True)
class Tracked:
    """Where a scan was taken.

    Attributes:
        pose: of the base in the map.
        information: (3, 3) of the pose relative to the surroundings that were set last, over x, y
            [m] and heading [rad] in the map's frame.
        fit: how well the scan fits, from 0 to 1; None if it has too few points where the last
            keyframes have seen anything.
        is_misfit: whether the scan fits nowhere near, and the pose is that of odometry.
        is_lost: whether so many scans in a row did that the robot was moved by hand.
        fit_of_all: how well all points fit, also those that are new or move, from 0 to 1.

    """

    pose: Pose
    information: Array
    fit: float | None
    is_misfit: bool = False
    is_lost: bool = False
    fit_of_all: float = 0.0


@dataclass(frozen=True)
class _Look:
    """What a scan at a pose shows: points that move (n,), number of known ones, fit of the rest."""

    moving: NDArray[np.bool_]
    known: int
    fit: float


class ScanTracker:
    """Aligns each scan to the points of the last keyframes, near where odometry puts it.

    A scan that fits badly there is searched for in the surroundings.
    """

    def __init__(self) -> None:
        self._recent: RecentSurfaces | None = None
        self._reference: Reference | None = None
        self._search_map: CorrelationMap | None = None
        self._usual_fit = 0.0
        self._misfits = 0
        self._elsewhere = 0  # scans in a row that show that the robot is elsewhere
        self._covariance = np.zeros((3, 3))  # since the surroundings were set

    @property
    def usual_fit(self) -> float:
        """How well scans have fitted lately, from 0 to 1."""
        return self._usual_fit

    def start(self) -> None:
        """Forget the keyframes: the robot is somewhere else."""
        self._recent = self._reference = self._search_map = None
        self._usual_fit, self._misfits, self._elsewhere = 0.0, 0, 0

    def set_surroundings(self, recent: RecentSurfaces) -> None:
        """Set what the last keyframes show."""
        self._recent = recent
        self._reference, self._search_map = Reference(recent.cloud), None
        self._covariance = np.zeros((3, 3))

    def track(self, pose: Pose, step: Pose, cloud: PointCloud, rays: Rays) -> Tracked:
        """Return where a scan was taken, `step` after a scan at `pose` by odometry.

        If the scan fits where odometry puts it, odometry is right about what the scan does not
        show. Otherwise the wheels may have slipped. What moves is left out.

        Args:
            pose: of the base in the map at the scan before.
            step: motion since then by odometry.
            cloud: the surfaces that the scan shows, in the frame of the base.
            rays: its rays, in the same frame.

        """
        guess = compose(pose, step)
        noise = _covariance(step, _NOISE)
        recent, reference = self._recent, self._reference
        if (
            recent is None
            or reference is None
            or min(cloud.count, reference.cloud.count) < _LEAST_POINTS
        ):
            self._misfits = self._elsewhere = 0
            return self._at(guess, noise, None, None)
        trusted = _inverse(_TRUSTED**2 * noise + np.diag([0.0, 0.0, _STAMPED_LATE_RAD**2]))
        how = guess, trusted, _REACH_M
        found = reference.align(cloud, *how)
        seen = _look(recent, cloud, found)
        if seen.known < _LEAST_POINTS:
            self._misfits = self._elsewhere = 0
            return self._at(guess, noise, None, None)
        is_surprising = apart(found.pose, guess, _SURPRISE_M, _SURPRISE_RAD)
        if is_surprising and not _shows_slip(recent, cloud, found, rays):
            found = reference.align(cloud, guess, _inverse(noise), _REACH_AFTER_SEARCH_M)
            seen = _look(recent, cloud, found)
        if seen.fit < _POOR_FIT * self._usual_fit or is_surprising:
            slip = _covariance(step, _SLIP)
            prior = _inverse(slip)
            tries = [(guess, prior, _REACH_M)]
            sd_m, sd_rad = math.sqrt(slip[0, 0]), math.sqrt(slip[2, 2])
            searched = self._search(cloud, guess, 0.1 + 2 * sd_m, 0.1 + 3 * sd_rad)
            if searched is not None:
                tries.append((searched, 0.1 * prior, _REACH_AFTER_SEARCH_M))
            others = [(reference.align(cloud, *one), one) for one in tries]
            other, other_how = max(others, key=lambda one: one[0].fit)
            is_better = other.fit > seen.fit + _BETTER / math.sqrt(cloud.count)
            is_possible = not apart(other.pose, guess, _SLIPS * sd_m, _SLIPS * sd_rad)
            if is_better and is_possible and _shows_slip(recent, cloud, other, rays):
                found, how, noise = other, other_how, slip
                seen = _look(recent, cloud, found)
        is_misfit = seen.fit < max(_NO_FIT, _NO_FIT_OF_USUAL * self._usual_fit)
        self._misfits = self._misfits + 1 if is_misfit else 0
        if is_misfit:
            moving, ends = _count(seen.moving), _count(np.isfinite(rays.ranges))
            is_elsewhere = recent.passed_share(guess, rays) > _PASSED or (
                moving > _IN_FREE_SPACE * seen.known and ends > _ENCLOSED * len(rays.ranges)
            )
            self._elsewhere = self._elsewhere + 1 if is_elsewhere else 0
            # Better a wrong step of odometry than one to where nothing fits.
            return self._at(guess, noise, None, seen.fit)
        self._elsewhere = 0
        found_points = cloud.count
        still = PointCloud(cloud.points[~seen.moving], cloud.normals[~seen.moving])
        if _LEAST_POINTS <= still.count < cloud.count:
            found = reference.align(still, *how)
            found_points = still.count
        fit = seen.fit
        fit_of_all = found.fit * found_points / cloud.count
        gain = _FIT_MEMORY if self._usual_fit else 1.0
        self._usual_fit += gain * (fit - self._usual_fit)
        share = min(1.0, _surface_cells(recent, cloud, found) / _SURFACE_CELLS)
        tracked = self._at(found.pose, noise, share**2 * found.information, fit)
        return replace(tracked, fit_of_all=fit_of_all)

    def _at(
        self, pose: Pose, noise: Array, information: Array | None, fit: float | None
    ) -> Tracked:
        """Return the result of a step with `noise` (3, 3) and of an alignment, if there is one."""
        self._covariance = self._covariance + noise
        known = _inverse(self._covariance)
        if information is not None:
            known += information
            self._covariance = _inverse(known)
        return Tracked(pose, known, fit, self._misfits > 0, self._elsewhere >= _MOVED_IN_A_ROW)

    def locate(self, pose: Pose, cloud: PointCloud, rays: Rays, reach: float) -> Tracked:
        """Search for where a scan was taken: up to `reach` [m] around a pose, facing anywhere."""
        guess = None
        if self._reference is not None:
            guess = self._search(cloud, pose, reach, math.pi)
        if guess is None:
            return Tracked(pose, np.zeros((3, 3)), 0.0, is_misfit=True)
        return self.track(guess, (0.0, 0.0, 0.0), cloud, rays)

    def _search(self, cloud: PointCloud, guess: Pose, reach: float, turn: float) -> Pose | None:
        assert self._reference is not None
        if self._search_map is None:
            self._search_map = CorrelationMap(self._reference.cloud.points)
        points = cloud.thinned(_SEARCH_CELL).points
        points = points[np.hypot(points[:, 0], points[:, 1]) < _SEARCH_REACH_M]
        if len(points) < _LEAST_POINTS:
            return None
        peaks = self._search_map.search(points, guess, reach, turn, _LEAST_SCORE)
        return peaks[0].pose if peaks else None


def _covariance(step: Pose, noise: Noise) -> Array:
    """Return the covariance (3, 3) of a step of odometry, in the map's frame."""
    forward, turn = math.hypot(step[0], step[1]), abs(step[2])
    (meters, per_m, m_per_rad), (radians, per_rad, rad_per_m) = noise
    sd_m = meters + per_m * forward + m_per_rad * turn
    sd_rad = radians + per_rad * turn + rad_per_m * forward
    covariance: Array = np.diag([sd_m**2, sd_m**2, sd_rad**2])
    return covariance


def _shows_slip(recent: RecentSurfaces, cloud: PointCloud, found: Alignment, rays: Rays) -> bool:
    """Return whether a scan that fits far from where odometry puts it shows that wheels slipped.

    A few points, as of a person or a pillar, fit anywhere.
    """
    cells = _surface_cells(recent, cloud, found)
    return cells >= _SURFACE_CELLS and recent.passed_share(found.pose, rays) < _PASSED


def _surface_cells(recent: RecentSurfaces, cloud: PointCloud, found: Alignment) -> int:
    """Return in how many cells a scan shows surfaces that stand still."""
    points = cloud.placed(found.pose).points
    surface = cloud.points[recent.known(points) & ~recent.moving(points)]
    return len(np.unique(np.floor(surface / _SURFACE_CELL_M).astype(np.int64), axis=0))


def _look(recent: RecentSurfaces, cloud: PointCloud, found: Alignment) -> _Look:
    """Compare a scan that is aligned with what the last keyframes have seen.

    Points where they have seen nothing are new: they say nothing about the fit.
    """
    points = cloud.placed(found.pose).points
    moving, known = recent.moving(points), _count(recent.known(points))
    people = _count(moving)
    compared = known - (people if people <= _MOST_MOVING * known else 0)
    return _Look(moving, known, min(1.0, found.fit * cloud.count / max(1, compared)))


def _count(chosen: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(chosen))


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), np.float64)
