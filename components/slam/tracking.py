"""Tracks the robot by aligning each scan to the keyframes just before it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.alignment import Alignment, Reference
from cairn.components.slam.correlation import CELL_M, REACH_M, CorrelationMap
from cairn.components.slam.odometry_log import LEAST_M, LEAST_RAD
from cairn.components.slam.point_cloud import NOTHING, PointCloud
from cairn.components.slam.pose_graph import AGREES, turned
from cairn.planar.motion_model import MEASURED, MotionModel, odometry_step
from cairn.planar.odometry_gains import SHOWN_M
from cairn.planar.poses import Pose, apart, compose, wrap

Array = NDArray[np.float64]

# A scan shows where the robot is with so many cells of surfaces, of this size [m]: 2 m of wall. A
# person fills three to five, and fits anywhere.
_LEAST_SURFACE, _SURFACE_CELL = 8, 0.25
# Wheels that slip move the robot by nothing to twice what odometry states, and by this [m], [rad].
_SLIP = 0.1
_MEMORY = 0.1  # share of the newest scan in what is usual
# A scan that fits worse than this share of the usual fit is not of this place. So many in a row
# mean that the robot was moved, if the first did not fit the scan before it either, or if the
# wheels stood still meanwhile. Else the place is new, or people hide it.
_NO_FIT, _NO_FIT_IN_A_ROW = 0.6, 4
# A scan follows the one before clearly with such a fit, where the next one could show a jump.
_CLEARLY = 0.5
# Where scans are usually farther from each other than this [m], they need not show the same. Steps
# that differ by less than this factor are usual.
_NEXT_M, _USUAL = 0.5, 2.0


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
        is_driven: whether the wheels turned as before meanwhile.
        by_odometry: (3, 3) how the pose relative to the surroundings changes with what odometry
            states, in the map's frame.

    """

    pose: Pose
    information: Array
    fit: float | None
    is_shown: bool = False
    is_misfit: bool = False
    is_lost: bool = False
    is_driven: bool = False
    by_odometry: Array = field(default_factory=lambda: np.zeros((3, 3)))


class ScanTracker:
    """Aligns each scan to the points of the last keyframes, near where odometry puts it.

    A scan that fits badly there is searched for in the surroundings.
    """

    def __init__(self, model: MotionModel = MEASURED) -> None:
        """Start without surroundings; `model` is the uncertainty of odometry."""
        self._model = model
        self._before: PointCloud | None = None  # what the last scan showed, where it was taken
        self._reference: Reference | None = None
        self._shows_enough = False
        self._search_map: CorrelationMap | None = None
        self.usual_fit = 0.0
        """How well scans have fitted lately, from 0 to 1."""
        self._usual_likelihood = 0.0  # the same as logarithm, per point
        self._least = np.diag(np.square([LEAST_M, LEAST_M, LEAST_RAD]))
        self._off = np.zeros(3)  # mean of the squares of how far odometry was off
        self._compared = 0  # scans that it is the mean of, at most those that are remembered
        self._misfits = self._since_jump = 0  # scans in a row
        self._steady = 0  # scans in a row between which the wheels turned as usual
        self._usual_step_m = 0.0
        # What the scan before that showed, the last one, and the step between them.
        self._earlier: tuple[PointCloud | None, PointCloud, Pose]
        self._earlier = (None, NOTHING, (0.0, 0.0, 0.0))
        self._driven: Pose = (0.0, 0.0, 0.0)  # by odometry, since the last scan that fitted
        # Since the surroundings were set, with what scans showed and by odometry alone.
        self._covariance, self._stated = np.zeros((3, 3)), np.zeros((3, 3))

    def start(self) -> None:
        """Forget the keyframes: the robot is somewhere else."""
        self._reference = self._search_map = None
        self.usual_fit, self._misfits, self._since_jump = 0.0, 0, 0

    def set_surroundings(self, cloud: PointCloud) -> None:
        """Set the points, in the map, of the last keyframes."""
        self._reference, self._search_map = Reference(cloud), None
        self._shows_enough = _surface_cells(cloud) >= _LEAST_SURFACE
        self._covariance, self._stated = np.zeros((3, 3)), np.zeros((3, 3))

    def track(self, pose: Pose, step: Pose, cloud: PointCloud, uncertain: float = 1.0) -> Tracked:
        """Return where a scan was taken, `step` after a scan at `pose` by odometry.

        If the scan fits where odometry puts it, odometry is right about what the scan does not
        show. Otherwise the wheels may have slipped, the place may be new, or the robot was moved.
        Odometry is `uncertain` times as uncertain as its model says.
        """
        length, usual = math.hypot(step[0], step[1]), self._usual_step_m
        self._steady = self._steady + 1 if usual / _USUAL < length < _USUAL * usual else 0
        tracked = self._track(pose, step, cloud, self._noise(pose, step, uncertain))
        self._usual_step_m += _MEMORY * (length - usual)
        self._earlier, self._before = (self._before, cloud, step), cloud
        return tracked

    def _noise(self, pose: Pose, step: Pose, uncertain: float) -> Array:
        """Return the covariance (3, 3) of a step of odometry, in the map's frame."""
        stated = replace(odometry_step(step), uncertain=uncertain)
        deviations = np.array(self._model.deviations(stated))
        return turned(np.diag(deviations**2) + self._least, -pose[2])

    def _track(self, pose: Pose, step: Pose, cloud: PointCloud, noise: Array) -> Tracked:
        guess = compose(pose, step)
        reference = self._reference
        if reference is None or not self._shows_enough or _surface_cells(cloud) < _LEAST_SURFACE:
            self._misfits = self._since_jump = 0
            return self._at(guess, noise, None, None)
        far, turn = math.hypot(step[0], step[1]), abs(step[2])
        slip = np.diag(np.square([_SLIP + far, _SLIP + far, _SLIP + turn]))
        # The robot may be pushed, and scans stamped late: that is seen before it is known.
        trusted = noise + AGREES**2 * (self._least + np.diag(self._off))
        found = reference.align(cloud, guess, _inverse(trusted))
        has_slipped = False
        # Could a scan that fits as usual, where wheels that slipped may have moved it, be likelier?
        usual = cloud.count * self._usual_likelihood
        if _score(found, guess, trusted) < usual + _log_density((0.0, 0.0, 0.0), slip):
            prior = _inverse(slip)
            others = [reference.align(cloud, guess, prior)]
            reach, angle = AGREES * (_SLIP + far), AGREES * (_SLIP + turn)
            searched = self._search(cloud, guess, reach, angle)
            if searched is not None:
                others.append(reference.align(cloud, searched, 0.1 * prior))
            other = max(others, key=lambda one: _score(one, guess, slip))
            if _score(other, guess, slip) > _score(found, guess, trusted):
                found, noise, has_slipped = other, slip, True
        is_misfit = found.fit < _NO_FIT * self.usual_fit
        self._misfits = self._misfits + 1 if is_misfit else 0
        self._driven = compose(self._driven, step) if self._misfits > 1 else step
        is_moving = _is_motion(self._driven)
        if not is_misfit:
            self._since_jump = 0
        else:
            prior = _inverse(trusted)
            follows = self._follows(cloud, step, prior)
            # A robot that was moved by hand sees one place and then another one. Where scan after
            # scan differs from the one before, there are leaves and grass, or nothing is near.
            jumps = not (follows or self._since_jump) and self._shows_same(
                *self._earlier, prior, _CLEARLY
            )
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
        gain = _MEMORY if self.usual_fit else 1.0
        self.usual_fit += gain * (found.fit - self.usual_fit)
        likelihood = found.log_likelihood / cloud.count
        self._usual_likelihood += gain * (likelihood - self._usual_likelihood)
        tracked = self._at(found.pose, noise, found.information, found.fit)
        if tracked.is_shown and not has_slipped:
            self._compare(found.pose, guess)
        return tracked

    def _compare(self, pose: Pose, guess: Pose) -> None:
        """Learn by how much odometry is off from scan to scan."""
        x, y, turn = pose[0] - guess[0], pose[1] - guess[1], wrap(pose[2] - guess[2])
        aside = 0.5 * (x**2 + y**2)
        self._compared += 1
        gain = max(_MEMORY, 1.0 / self._compared)
        self._off += gain * (np.array([aside, aside, turn**2]) - self._off)

    def _follows(self, cloud: PointCloud, step: Pose, prior: Array) -> bool:
        """Return whether a scan shows the same as the one before, `step` from there."""
        usual = self._usual_step_m
        may_differ = usual > _NEXT_M and math.hypot(step[0], step[1]) < _USUAL * usual
        # Of two scans that each show this share of the same place, both show the square of it.
        return may_differ or self._shows_same(
            self._before, cloud, step, prior, _NO_FIT**2 * self.usual_fit
        )

    def _shows_same(
        self, before: PointCloud | None, after: PointCloud, step: Pose, prior: Array, least: float
    ) -> bool:
        """Return whether a scan shows the same as one `step` before it, if that shows enough.

        Its fit is at least `least` then.
        """
        if before is None or _surface_cells(before) < _LEAST_SURFACE:
            return True
        return Reference(before).align(after, step, prior).fit >= least

    def _at(
        self, pose: Pose, noise: Array, information: Array | None, fit: float | None
    ) -> Tracked:
        """Return the result of a step with `noise` (3, 3) and of an alignment, if there is one."""
        self._covariance, self._stated = self._covariance + noise, self._stated + noise
        known = _inverse(self._covariance)
        is_shown = False
        if information is not None:
            known += information
            self._covariance = _inverse(known)
            position = np.linalg.eigvalsh(_inverse(information)[:2, :2])
            is_shown = bool(position[-1] < SHOWN_M**2)
        is_lost = self._since_jump >= _NO_FIT_IN_A_ROW
        is_driven = is_lost and self._steady > self._since_jump and _is_motion(self._driven)
        by_odometry = self._covariance @ _inverse(self._stated)
        is_misfit = self._misfits > 0
        return Tracked(pose, known, fit, is_shown, is_misfit, is_lost, is_driven, by_odometry)

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
        if not len(points):
            return None
        peaks = self._search_map.search(points, guess, reach, turn, _NO_FIT * self.usual_fit)
        return peaks[0].pose if peaks else None


def _score(found: Alignment, guess: Pose, covariance: Array) -> float:
    """Return the log likelihood of an alignment, with what odometry says."""
    x, y, theta = found.pose
    off = (x - guess[0], y - guess[1], wrap(theta - guess[2]))
    return found.log_likelihood + _log_density(off, covariance)


def _log_density(off: Pose, covariance: Array) -> float:
    """Return the logarithm of a normal density, but for a constant; -inf where nothing agrees."""
    square = float(off @ _inverse(covariance) @ off)
    if square > AGREES**2:
        return -math.inf
    return -0.5 * (square + float(np.linalg.slogdet(covariance)[1]))


def _is_motion(driven: Pose) -> bool:
    """Return whether the wheels turned by more than the deviations of odometry."""
    return apart(driven, (0.0, 0.0, 0.0), AGREES * LEAST_M, AGREES * LEAST_RAD)


def _surface_cells(cloud: PointCloud) -> int:
    """Return in how many cells points show surfaces."""
    return len(np.unique(np.floor(cloud.points / _SURFACE_CELL).astype(np.int64), axis=0))


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), np.float64)
