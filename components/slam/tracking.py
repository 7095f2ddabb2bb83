"""Tracks the robot by aligning each scan to the keyframes just before it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.alignment import Reference
from cairn.components.slam.correlation import CorrelationMap
from cairn.components.slam.point_cloud import PointCloud
from cairn.planar.poses import Pose, apart, compose

Array = NDArray[np.float64]

# A scan with fewer points is not aligned: the robot is where odometry says.
_LEAST_POINTS = 20
# How far a pose may be from where odometry puts it, as standard deviations: constant [m], [rad],
# per meter and per radian. Wheels that slip turn the robot by tenths of a radian.
_SLIP_M, _SLIP_PER_M, _SLIP_M_PER_RAD = 0.1, 0.2, 0.02
_SLIP_RAD, _SLIP_PER_RAD, _SLIP_RAD_PER_M = 0.1, 0.2, 0.05
# Noise of odometry itself: constant, per meter, per radian.
_NOISE_M, _NOISE_PER_M, _NOISE_M_PER_RAD = 0.005, 0.05, 0.01
_NOISE_RAD, _NOISE_PER_RAD, _NOISE_RAD_PER_M = 0.003, 0.05, 0.02
# Points are paired up to this distance at first [m]; less after a search.
_REACH_M, _REACH_AFTER_SEARCH_M = 0.4, 0.2
# A scan is searched for if it fits worse than this share of the usual fit, or if its pose is so far
# from where odometry puts it [m], [rad].
_POOR_FIT, _SURPRISE_M, _SURPRISE_RAD = 0.8, 0.1, 0.06
_FIT_MEMORY = 0.1  # share of the newest scan in the usual fit
# Least score of a searched pose, and by how much it must fit better.
_LEAST_SCORE, _BETTER = 0.3, 0.03
# Points of a search: one in this many meters, no farther than this [m].
_SEARCH_CELL, _SEARCH_REACH_M = 0.1, 15.0
# A scan that fits worse is not of this place; so many in a row mean that the robot was moved.
_NO_FIT, _NO_FIT_IN_A_ROW = 0.3, 4


@dataclass(frozen=True)
class Tracked:
    """Where a scan was taken.

    Attributes:
        pose: of the base in the map.
        information: (3, 3) of the step from the scan before, over x, y [m] and heading [rad] in the
            map's frame.
        fit: how well the scan fits, from 0 to 1; None if it has too few points.
        is_lost: whether the last scans fit nowhere: the robot was moved by hand.

    """

    pose: Pose
    information: Array
    fit: float | None
    is_lost: bool


class ScanTracker:
    """Aligns each scan to the points of the last keyframes, near where odometry puts it.

    A scan that fits badly there is searched for in the surroundings.
    """

    def __init__(self) -> None:
        self._reference: Reference | None = None
        self._search_map: CorrelationMap | None = None
        self._usual_fit = 0.0
        self._misfits = 0

    @property
    def usual_fit(self) -> float:
        """How well scans have fitted lately, from 0 to 1."""
        return self._usual_fit

    def start(self) -> None:
        """Forget the keyframes: the robot is somewhere else."""
        self._reference = self._search_map = None
        self._usual_fit, self._misfits = 0.0, 0

    def set_surroundings(self, cloud: PointCloud) -> None:
        """Set the points, in the map, of the last keyframes."""
        self._reference, self._search_map = Reference(cloud), None

    def track(self, pose: Pose, step: Pose, cloud: PointCloud) -> Tracked:
        """Return where a scan was taken, `step` after a scan at `pose` by odometry."""
        guess = compose(pose, step)
        noise = _step_information(step)
        reference = self._reference
        if reference is None or min(cloud.count, reference.cloud.count) < _LEAST_POINTS:
            return Tracked(guess, noise, None, False)
        forward, turn = math.hypot(step[0], step[1]), abs(step[2])
        sd_m = _SLIP_M + _SLIP_PER_M * forward + _SLIP_M_PER_RAD * turn
        sd_rad = _SLIP_RAD + _SLIP_PER_RAD * turn + _SLIP_RAD_PER_M * forward
        prior = np.diag([sd_m**-2, sd_m**-2, sd_rad**-2])
        found = reference.align(cloud, guess, prior, _REACH_M)
        if found.fit < _POOR_FIT * self._usual_fit or apart(
            found.pose, guess, _SURPRISE_M, _SURPRISE_RAD
        ):
            searched = self._search(cloud, guess, 0.1 + 2 * sd_m, 0.1 + 3 * sd_rad)
            if searched is not None:
                other = reference.align(cloud, searched, 0.1 * prior, _REACH_AFTER_SEARCH_M)
                if other.fit > found.fit + _BETTER:
                    found = other
        self._misfits = self._misfits + 1 if found.fit < _NO_FIT else 0
        if self._misfits:
            # Better a wrong step of odometry than one to where nothing fits.
            return Tracked(guess, noise, found.fit, self._misfits >= _NO_FIT_IN_A_ROW)
        gain = _FIT_MEMORY if self._usual_fit else 1.0
        self._usual_fit += gain * (found.fit - self._usual_fit)
        return Tracked(found.pose, found.information + noise, found.fit, False)

    def locate(self, pose: Pose, cloud: PointCloud, reach: float) -> Tracked:
        """Search for where a scan was taken: up to `reach` [m] around a pose, facing anywhere."""
        guess = None
        if self._reference is not None:
            guess = self._search(cloud, pose, reach, math.pi)
        if guess is None:
            return Tracked(pose, np.zeros((3, 3)), 0.0, True)
        return self.track(guess, (0.0, 0.0, 0.0), cloud)

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


def _step_information(step: Pose) -> Array:
    """Return the information (3, 3) of a step of odometry, in the map's frame."""
    forward, turn = math.hypot(step[0], step[1]), abs(step[2])
    sd_m = _NOISE_M + _NOISE_PER_M * forward + _NOISE_M_PER_RAD * turn
    sd_rad = _NOISE_RAD + _NOISE_PER_RAD * turn + _NOISE_RAD_PER_M * forward
    information: Array = np.diag([sd_m**-2, sd_m**-2, sd_rad**-2])
    return information
