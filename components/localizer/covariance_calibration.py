"""Calibrates the published covariance: that of the particles, and errors that no particles show."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.pose_differences import LEVER_M
from cairn.planar.poses import wrap

Array = NDArray[np.float64]

# Weight of the newest scan in the running means: means over 20 scans. Benchmark `localization_logs`
# measures how often the truth lies within the covariance that results (docs/benchmarks.md).
_NEWEST = 0.05
# Exact beams deviate so much from a map of cells [cells].
_CELLS = 0.54


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
        # Running means over x, y, heading times `LEVER_M` [m]: of corrections, of their squares
        # [m^2], and of how much the particles shrank.
        self._mean = np.zeros(3)
        self._made, self._due = np.zeros((3, 3)), np.zeros((3, 3))
        self._map_error: Array | None = None

    def add_correction(self, before: PoseEstimate, after: PoseEstimate, share: float) -> None:
        """Add the change of the estimate by a scan, of which `share` (0 to 1) is new."""
        x, y, theta = (b - a for a, b in zip(before.mean, after.mean, strict=True))
        change = np.array([x, y, LEVER_M * wrap(theta)])
        shrunk = _scaled(before.covariance - after.covariance, LEVER_M)
        newest = _NEWEST * share
        self._mean += newest * (change - self._mean)
        self._made += newest * (np.outer(change, change) - self._made)
        self._due += newest * (shrunk - self._due)

    def add_scan(
        self, field: LikelihoodField, pose: PoseEstimate, points: Array, share: float
    ) -> None:
        """Add how far the end points (m, 2) [m] of a scan deviate from the map at a pose.

        As the errors of beams repeat, they count as the share `share` of them.
        """
        cells = (_CELLS * field.frame.resolution) ** 2
        beyond = max(0.0, field.deviation(pose.mean, points) ** 2 - cells)
        error = beyond + cells / (share * len(points))
        # An error of the map at the beams' ends turns the robot by the less the farther they are.
        turn = error / float(np.mean(np.square(points).sum(axis=1)))
        variances = np.array([error, error, turn])
        last = variances if self._map_error is None else self._map_error
        self._map_error = last + _NEWEST * (variances - last)

    def calibrated(self, particles: PoseEstimate) -> Array:
        """Return the covariance (3, 3) to publish."""
        spread = _scaled(particles.covariance, LEVER_M)
        widths, axes = np.linalg.eigh(spread)
        made, due = (_along(axes, matrix) for matrix in (self._made, self._due))
        # Axes of which scans show nothing keep their width: the particles count a little.
        little = _NEWEST**2 * np.maximum(widths, 0.0) + np.finfo(float).tiny
        scale = (made + little) / (np.maximum(0.0, due) + little)
        stated = (axes * (scale * widths)) @ axes.T
        # Random corrections leave half of the weight times their square in a running mean. The rest
        # is steady: each scan corrects the share of the lag by which the particles shrink.
        steady = self._mean @ self._mean
        if steady > 0.0:
            way = self._mean[:, None] / math.sqrt(steady)
            [width], [made], [due] = (
                _along(way, matrix) for matrix in (spread, self._made, self._due)
            )
            left = 1.0 + width / max(due, _NEWEST**2 * width)
            stated += max(0.0, steady - 0.5 * _NEWEST * made) * left**2 * (way @ way.T)
        result = _scaled(stated, 1.0 / LEVER_M)
        return result if self._map_error is None else result + np.diag(self._map_error)


def _scaled(covariance: Array, lever: float) -> Array:
    """Return a covariance (3, 3) with the heading multiplied."""
    each = np.array([1.0, 1.0, lever])
    return covariance * np.outer(each, each)


def _along(axes: Array, matrix: Array) -> Array:
    """Return the variance of a matrix (3, 3) along each of some axes, the columns (3, 3)."""
    variances: Array = np.einsum("ji,jk,ki->i", axes, matrix, axes)
    return variances
