"""Calibrates the published covariance: that of the particles, and errors that no particles show."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.particle_set import PoseEstimate
from cairn.planar.compiled import compiled
from cairn.planar.poses import wrap

Array = NDArray[np.float64]

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double. Benchmark `localization_logs` measures how often the truth lies
# within the covariance that results (docs/benchmarks.md).

# Weights of the newest scan in the running means: means over 20 scans. Truth within 1 sigma on
# fr101, fr079: 71, 83 %; with half and double the first one 68, 83 % and 73, 84 %, with half and
# double the second one 66, 83 % and 72, 83 %.
_NEWEST_STEP, _NEWEST_FIT = 0.05, 0.05
# Added to actual and expected corrections, so that tiny ones have no effect [m^2], [rad^2].
_LITTLE_M2, _LITTLE_RAD2 = 1e-6, 1e-7
# The published deviations are at least and at most these multiples of those of the particles.
_NARROWEST, _WIDEST = 0.2, 3.0
# The lag is at most so many deviations of the particles.
_LONGEST_LAG = 6.0
# Random corrections leave the share w / (2 - w) = 0.026 of their mean square in a running mean of
# weight w; eight times that is exceeded in 0.5 % of the cases (chi-square, 1 degree of freedom).
_AT_RANDOM = 4.0 * _NEWEST_STEP
# Exact beams deviate so much from a map of cells, and move the pose so far [cells]; what is beyond
# is the error of the map, which turns the robot so much [rad / m].
_DEVIATION_OF_CELLS, _ERROR_OF_CELLS = 0.54, 0.125
_TURN_PER_M = 0.1
_LEAST_TURN = 0.002  # [rad], the heading's share of the error of cells


class CovarianceCalibrator:
    """Makes the published covariance honest: the truth lies within one sigma as often as for a
    normal distribution.

    The particles are as wide as the models of motion and beams make them. If these models are
    right, each scan corrects the pose, on average, by as much as the particles shrink; their width
    is scaled accordingly (innovation-based estimation, Mehra 1970), along each of their axes
    separately: a scan across a corridor does not show how far along it the robot is. Added is the
    lag of a pose whose corrections always point in the same direction, as odometry errs steadily;
    and the error of the map, which all beams share, so that no particles show it: it is as large as
    the deviation of the beams from the map beyond what cells of its size explain.
    """

    def __init__(self) -> None:
        # Running means of corrections over x, y [m] in the map, of their squares [m^2], of what was
        # due, and over the heading [rad^2].
        self._mean = np.zeros(2)
        self._made, self._due = np.zeros((2, 2)), np.zeros((2, 2))
        self._turn_made = self._turn_due = 0.0
        self._beyond: float | None = None

    def add_correction(self, before: PoseEstimate, after: PoseEstimate, share: float) -> None:
        """Add the change of the estimate by a scan, of which `share` (0 to 1) is new."""
        x, y, theta = (b - a for a, b in zip(before.mean, after.mean, strict=True))
        shrunk = before.covariance - after.covariance
        newest = _NEWEST_STEP * share
        self._mean += newest * (np.array([x, y]) - self._mean)
        self._made += newest * (np.array([[x * x, x * y], [x * y, y * y]]) - self._made)
        self._due += newest * (shrunk[:2, :2] - self._due)
        self._turn_made += newest * (wrap(theta) ** 2 - self._turn_made)
        self._turn_due += newest * (max(0.0, shrunk[2, 2]) - self._turn_due)

    def add_deviation(self, deviation: float, resolution: float) -> None:
        """Add by how much [m, rms; NaN: unknown] beams deviate from a map of such cells [m]."""
        if math.isnan(deviation):
            return
        beyond = max(0.0, deviation**2 - (_DEVIATION_OF_CELLS * resolution) ** 2)
        last = beyond if self._beyond is None else self._beyond
        self._beyond = last + _NEWEST_FIT * (beyond - last)

    def calibrated(self, particles: PoseEstimate, resolution: float) -> Array:
        """Return the covariance (3, 3) to publish, on a map of cells of that size [m]."""
        each, behind = np.zeros((3, 3)), np.zeros((3, 3))
        _axes(particles.covariance, self._mean, self._made, self._due, each, behind)
        each[2, 2] = _scale(self._turn_made, self._turn_due, _LITTLE_RAD2)
        off = (_ERROR_OF_CELLS * resolution) ** 2 + (self._beyond or 0.0)
        turn = _LEAST_TURN**2 + _TURN_PER_M**2 * (self._beyond or 0.0)
        stated: Array = each @ particles.covariance @ each + behind + np.diag([off, off, turn])
        return stated


@compiled("float64(float64, float64, float64)")
def _scale(made: float, due: float, little: float) -> float:
    """Return by how much corrections of the mean square `made` are wider than those that were
    `due`.
    """
    ratio = math.sqrt((made + little) / (max(0.0, due) + little))
    return min(max(ratio, _NARROWEST), _WIDEST)


@compiled()
def _along(x: float, y: float, matrix: Array) -> float:
    """Return the variance in a direction."""
    return float(x * x * matrix[0, 0] + 2.0 * x * y * matrix[0, 1] + y * y * matrix[1, 1])


@compiled()
def _add(x: float, y: float, value: float, matrix: Array) -> None:
    """Add a variance in a direction."""
    matrix[0, 0] += value * x * x
    matrix[0, 1] += value * x * y
    matrix[1, 0] += value * x * y
    matrix[1, 1] += value * y * y


@compiled()
def _lag(mean: float, made: float, due: float, variance: float) -> float:
    """Return the square [m^2] of how far the pose lags behind if odometry errs steadily.

    Scans then correct it by the same `mean` [m] again and again: by the share of the error by which
    particles of that variance [m^2] shrank when `due` was removed. What random corrections of the
    mean square `made` leave in a running mean is not lag.
    """
    steady = mean * mean - _AT_RANDOM * made
    if steady <= 0.0:
        return 0.0
    gain = (max(0.0, due) + _LITTLE_M2) / (variance + max(0.0, due) + _LITTLE_M2)
    return min(steady / gain**2, _LONGEST_LAG**2 * variance)


@compiled(
    "void(float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1],"
    " float64[:, ::1])"
)
def _axes(spread: Array, mean: Array, made: Array, due: Array, each: Array, behind: Array) -> None:
    """Put the scales of x and y along the axes of the particles into `each`, what the lag adds
    into `behind`.
    """
    angle = 0.5 * math.atan2(2.0 * spread[0, 1], spread[0, 0] - spread[1, 1])
    for turn in (0.0, 0.5 * math.pi):
        x, y = math.cos(angle + turn), math.sin(angle + turn)
        _add(x, y, _scale(_along(x, y, made), _along(x, y, due), _LITTLE_M2), each)
    way = math.atan2(mean[1], mean[0])
    x, y = math.cos(way), math.sin(way)
    length = math.hypot(mean[0], mean[1])
    variance = _along(x, y, spread)
    _add(x, y, _lag(length, _along(x, y, made), _along(x, y, due), variance), behind)
