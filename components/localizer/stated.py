"""The covariance that is stated with a pose: the cloud's, and what no cloud shows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from components.localizer.particles import Estimate
from planar.poses import wrap

Array = NDArray[np.float64]

# Shares of the newest scan in the running means.
_NEWEST_STEP, _NEWEST_FIT = 0.05, 0.05
# Added to what corrections are and should be, so that tiny ones say nothing [m^2], [rad^2].
_LITTLE = np.array([1e-6, 1e-7])
# A cloud is said to be at most so much narrower or wider than it is.
_NARROWEST, _WIDEST = 0.2, 3.0
# Beams that measure exactly deviate so much from a map of cells, and bring the pose so far off
# [cells]; what is beyond is the map's error, which turns the robot so much [rad / m].
_DEVIATION_OF_CELLS, _ERROR_OF_CELLS = 0.54, 0.125
_TURN_PER_M = 0.1
_LEAST_TURN = 0.002


class StatedCovariance:
    """Keeps the stated covariance honest: the truth is to lie within one sigma as often as of a
    normal distribution.

    The cloud is as wide as its models of motion and beams make it. A filter whose models are right
    is corrected by each scan as far as the cloud shrinks with it, on average; by that its width is
    scaled (innovation-based estimation, Mehra 1970). Added is the error of the map, which all beams
    share, so that no cloud shows it: as large as the beams' deviation from the map beyond what
    cells of its size explain.
    """

    def __init__(self) -> None:
        self._made, self._due = np.zeros(2), np.zeros(2)
        self._beyond: float | None = None

    def corrected(self, before: Estimate, after: Estimate, share: float) -> None:
        """Note what a scan, of which `share` (0 to 1) is new, made of the cloud."""
        x, y, theta = (b - a for a, b in zip(before.mean, after.mean, strict=True))
        shrunk = np.diag(before.covariance) - np.diag(after.covariance)
        made = np.array([x * x + y * y, wrap(theta) ** 2])
        due = np.maximum(0.0, [shrunk[0] + shrunk[1], shrunk[2]])
        newest = _NEWEST_STEP * share
        self._made += newest * (made - self._made)
        self._due += newest * (due - self._due)

    def fitted(self, deviation: float, resolution: float) -> None:
        """Note by how much [m, rms; NaN: unknown] beams deviate from a map of such cells [m]."""
        if math.isnan(deviation):
            return
        beyond = max(0.0, deviation**2 - (_DEVIATION_OF_CELLS * resolution) ** 2)
        last = beyond if self._beyond is None else self._beyond
        self._beyond = last + _NEWEST_FIT * (beyond - last)

    def of(self, cloud: Estimate, resolution: float) -> Array:
        """The covariance (3, 3) to state, on a map of cells of that size [m]."""
        scale = np.clip(
            np.sqrt((self._made + _LITTLE) / (self._due + _LITTLE)), _NARROWEST, _WIDEST
        )
        each = np.diag([scale[0], scale[0], scale[1]])
        off = (_ERROR_OF_CELLS * resolution) ** 2 + (self._beyond or 0.0)
        turn = _LEAST_TURN**2 + _TURN_PER_M**2 * (self._beyond or 0.0)
        stated: Array = each @ cloud.covariance @ each + np.diag([off, off, turn])
        return stated
