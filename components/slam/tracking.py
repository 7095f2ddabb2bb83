"""Tracks the robot by aligning each scan to the keyframes just before it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.alignment import Reference
from cairn.components.slam.correlation import CELL_M, REACH_M, CorrelationMap
from cairn.components.slam.point_cloud import PointCloud
from cairn.planar.odometry_gains import SHOWN_M
from cairn.planar.poses import Pose, apart, compose

Array = NDArray[np.float64]
Noise = tuple[tuple[float, float, float], tuple[float, float, float]]

# A scan with fewer points is not aligned: the robot is where odometry says.
_LEAST_POINTS = 20
# How far a pose may be from where odometry puts it, as standard deviations: of the position,
# constant [m], per meter, and per radian [m/rad]; of the heading, constant [rad], per radian, and
# per meter [rad/m]. If wheels slip, they turn the robot by tenths of a radian.
_NOISE: Noise = ((0.005, 0.05, 0.01), (0.003, 0.05, 0.02))
_SLIP: Noise = ((0.05, 0.3, 0.02), (0.1, 0.2, 0.05))
# Wheels slip by at most so many of their standard deviations: the robot does not jump.
_MOST_SLIP = 3.0
# A scan is aligned with so many times the noise first, as the noise of successive steps has a
# common sign.
_TRUSTED = 2.5
# Beyond that, the heading may be off by this [rad]: a scan that is stamped 0.1 s late shows a robot
# that turns by 0.5 rad/s. With it, the relations of fr079 are 0.43 deg off, without 0.48.
_STAMPED_LATE_RAD = 0.05
# A scan is searched for if it fits worse than this share of the usual fit, or if its pose is so far
# from where odometry puts it [m], [rad].
_POOR_FIT, _SURPRISE_M, _SURPRISE_RAD = 0.8, 0.1, 0.06
_FIT_MEMORY = 0.1  # share of the newest scan in the usual fit
# Least score of a searched pose. How much better a scan must fit for the wheels to have slipped,
# times the square root of the number of its points: few points fit by chance.
_LEAST_SCORE, _BETTER = 0.3, 2.0
# A scan shows where the robot is with so many cells of surfaces, of this size [m]: 2 m of wall; and
# that wheels have slipped with so many that fit. A person fills three to five, and fits anywhere.
_LEAST_SURFACE, _SLIP_SURFACE, _SURFACE_CELL = 8, 16, 0.25
# A scan that fits worse than this, or than this share of the usual fit, is not of this place. So
# many in a row mean that the robot was moved, if the first did not fit the scan before it either,
# or if the wheels moved it by no more than this meanwhile [m], [rad]. Else the place is new, or
# people hide it.
_NO_FIT, _NO_FIT_OF_USUAL, _NO_FIT_IN_A_ROW = 0.3, 0.6, 4
_STANDS_M, _STANDS_RAD = 0.02, 0.02
# A scan follows the one before with such a fit, where the next one could show a jump.
_FOLLOWS = 0.5
# Where scans are usually farther from each other than this [m], they need not show the same.
_NEXT_M = 0.5


@dataclass(frozen=True)
class Tracked:
    """Where a scan was taken.

    Attributes:
        pose: of the base in the map.
        information: (3, 3) of the pose relative to the surroundings that were set last, over x, y
            [m] and heading [rad] in the map's frame.
        fit: how well the scan fits, from 0 to 1; None if it shows too little, or nothing that was
            seen before.
        is_shown: whether the scan shows the position in all directions.
        is_misfit: whether the scan fits nowhere near, and the pose is that of odometry.
        is_lost: whether so many scans in a row did that the robot was moved by hand: one did not
            fit the scan before it either, or the wheels stood still.

    """

    pose: Pose
    information: Array
    fit: float | None
    is_shown: bool = False
    is_misfit: bool = False
    is_lost: bool = False


class ScanTracker:
    """Aligns each scan to the points of the last keyframes, near where odometry puts it.

    A scan that fits badly there is searched for in the surroundings.
    """

    def __init__(self) -> None:
        self._before: PointCloud | None = None  # what the last scan showed, where it was taken
        self._reference: Reference | None = None
        self._search_map: CorrelationMap | None = None
        self.usual_fit = 0.0
        """How well scans have fitted lately, from 0 to 1."""
        self._misfits = self._since_jump = 0  # scans in a row
        self._usual_step_m = 0.0
        # What the scan before that showed, and the step to the last one.
        self._earlier: tuple[PointCloud | None, Pose] = (None, (0.0, 0.0, 0.0))
        self._driven: Pose = (0.0, 0.0, 0.0)  # by odometry, since the last scan that fitted
        self._covariance = np.zeros((3, 3))  # since the surroundings were set

    def start(self) -> None:
        """Forget the keyframes: the robot is somewhere else."""
        self._reference = self._search_map = None
        self.usual_fit, self._misfits, self._since_jump = 0.0, 0, 0

    def set_surroundings(self, cloud: PointCloud) -> None:
        """Set the points, in the map, of the last keyframes."""
        self._reference, self._search_map = Reference(cloud), None
        self._covariance = np.zeros((3, 3))

    def track(self, pose: Pose, step: Pose, cloud: PointCloud) -> Tracked:
        """Return where a scan was taken, `step` after a scan at `pose` by odometry.

        If the scan fits where odometry puts it, odometry is right about what the scan does not
        show. Otherwise the wheels may have slipped, the place may be new, or the robot was moved.
        """
        tracked = self._track(pose, step, cloud)
        self._earlier = (self._before, step)
        self._before = cloud
        length = math.hypot(step[0], step[1])
        self._usual_step_m += _FIT_MEMORY * (length - self._usual_step_m)
        return tracked

    def _track(self, pose: Pose, step: Pose, cloud: PointCloud) -> Tracked:
        guess = compose(pose, step)
        noise = _covariance(step, _NOISE)
        reference = self._reference
        surfaces = _surface_cells(cloud.points)
        if (
            reference is None
            or min(cloud.count, reference.cloud.count) < _LEAST_POINTS
            or surfaces < _LEAST_SURFACE
        ):
            self._misfits = self._since_jump = 0
            return self._at(guess, noise, None, None)
        trusted = _inverse(_TRUSTED**2 * noise + np.diag([0.0, 0.0, _STAMPED_LATE_RAD**2]))
        found = reference.align(cloud, guess, trusted)
        if found.fit < _POOR_FIT * self.usual_fit or apart(
            found.pose, guess, _SURPRISE_M, _SURPRISE_RAD
        ):
            slip = _covariance(step, _SLIP)
            prior = _inverse(slip)
            others = [reference.align(cloud, guess, prior)]
            sd_m, sd_rad = math.sqrt(slip[0, 0]), math.sqrt(slip[2, 2])
            searched = self._search(cloud, guess, 0.1 + 2 * sd_m, 0.1 + 3 * sd_rad)
            if searched is not None:
                others.append(reference.align(cloud, searched, 0.1 * prior))
            other = max(others, key=lambda one: one.fit)
            is_better = other.fit > found.fit + _BETTER / math.sqrt(cloud.count)
            is_possible = not apart(other.pose, guess, _MOST_SLIP * sd_m, _MOST_SLIP * sd_rad)
            if is_better and is_possible and surfaces * other.paired >= _SLIP_SURFACE:
                found, noise = other, slip
        is_misfit = found.fit < max(_NO_FIT, _NO_FIT_OF_USUAL * self.usual_fit)
        self._misfits = self._misfits + 1 if is_misfit else 0
        self._driven = compose(self._driven, step) if self._misfits > 1 else step
        is_moving = apart(self._driven, (0.0, 0.0, 0.0), _STANDS_M, _STANDS_RAD)
        if not is_misfit:
            self._since_jump = 0
        else:
            follows = self._follows(cloud, step, trusted)
            # A robot that was moved by hand sees one place and then another one. Where scan after
            # scan differs from the one before, there are leaves and grass, or nothing is near.
            jumps = not follows and not self._since_jump and self._followed_before(trusted)
            is_new_place = self._misfits >= _NO_FIT_IN_A_ROW and not (self._since_jump or jumps)
            if is_moving and (is_new_place or (self._since_jump and not follows)):
                # Or people stand around: only odometry shows the way.
                self._misfits = self._since_jump = 0
                return self._at(guess, noise, None, None)
            if is_new_place:
                self._since_jump = self._misfits
            elif self._since_jump or jumps:
                self._since_jump += 1
        if self._misfits:
            # Better a wrong step of odometry than one to where nothing fits.
            return self._at(guess, noise, None, found.fit)
        gain = _FIT_MEMORY if self.usual_fit else 1.0
        self.usual_fit += gain * (found.fit - self.usual_fit)
        return self._at(found.pose, noise, found.information, found.fit)

    def _follows(self, cloud: PointCloud, step: Pose, prior: Array) -> bool:
        """Return whether a scan shows the same as the one before, `step` from there."""
        before = self._before
        if before is None or before.count < _LEAST_POINTS:
            return True
        if self._usual_step_m > _NEXT_M and math.hypot(step[0], step[1]) < 2 * self._usual_step_m:
            return True
        return Reference(before).align(cloud, step, prior).fit >= _NO_FIT

    def _followed_before(self, prior: Array) -> bool:
        """Return whether the scan before showed the same as the one before that, clearly."""
        (earlier, step), before = self._earlier, self._before
        if earlier is None or before is None or earlier.count < _LEAST_POINTS:
            return True
        return Reference(earlier).align(before, step, prior).fit >= _FOLLOWS

    def _at(
        self, pose: Pose, noise: Array, information: Array | None, fit: float | None
    ) -> Tracked:
        """Return the result of a step with `noise` (3, 3) and of an alignment, if there is one."""
        self._covariance = self._covariance + noise
        known = _inverse(self._covariance)
        is_shown = False
        if information is not None:
            known += information
            self._covariance = _inverse(known)
            position = np.linalg.eigvalsh(_inverse(information)[:2, :2])
            is_shown = bool(position[-1] < SHOWN_M**2)
        is_lost = self._since_jump >= _NO_FIT_IN_A_ROW
        return Tracked(pose, known, fit, is_shown, self._misfits > 0, is_lost)

    def locate(self, pose: Pose, cloud: PointCloud, reach: float) -> Tracked:
        """Search for where a scan was taken: up to `reach` [m] around a pose, facing anywhere."""
        guess = None
        if self._reference is not None:
            guess = self._search(cloud, pose, reach, math.pi)
        if guess is None:
            return Tracked(pose, np.zeros((3, 3)), 0.0, is_misfit=True)
        return self.track(guess, (0.0, 0.0, 0.0), cloud)

    def _search(self, cloud: PointCloud, guess: Pose, reach: float, turn: float) -> Pose | None:
        assert self._reference is not None
        if self._search_map is None:
            self._search_map = CorrelationMap(self._reference.cloud.points)
        points = cloud.thinned(CELL_M).points
        points = points[np.hypot(points[:, 0], points[:, 1]) < REACH_M]
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


def _surface_cells(points: Array) -> int:
    """Return in how many cells points (n, 2) [m] show surfaces."""
    return len(np.unique(np.floor(points / _SURFACE_CELL).astype(np.int64), axis=0))


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), np.float64)
