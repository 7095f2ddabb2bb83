"""How likely a sighting of a mapped object is from each pose of a cloud."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import wrap_all

# Log-density of a sighting that has nothing to do with the object's place in the map, relative
# to the peak of the sighting's own Gaussian (NIS 9.2).
STRAY = -4.6


@dataclass(frozen=True)
class Sighting:
    """One recognized object: range [m], bearing [rad, left positive] and their variances.

    `alternatives` are other objects that it may be as well.
    """

    object_id: int
    range_m: float
    bearing: float
    range_variance: float
    bearing_variance: float
    alternatives: tuple[int, ...] = ()


@dataclass(frozen=True)
class Landmark:
    """An object of the visual map: place [m], its covariance [m^2], reliability, liveness."""

    object_id: int
    x: float
    y: float
    xx: float = 0.0
    xy: float = 0.0
    yy: float = 0.0
    reliability: float = 0.5
    live: bool = True


def believed(landmark: Landmark) -> Landmark:
    """The same as if it certainly stood where the map says."""
    return replace(landmark, reliability=1.0)


def object_log_likelihood(
    poses: NDArray[np.float64], sighting: Sighting, landmark: Landmark
) -> NDArray[np.float64]:
    """Log-weights (...) that `sighting` adds to `poses` (3, ...).

    A mixture: with probability `reliability` the object stands where the map says and the
    sighting is Gaussian in range and bearing; else the sighting is a stray of constant density.
    So no single sighting can rule a pose out, but one of an object whose reliability is 1.
    """
    dx = landmark.x - poses[0]
    dy = landmark.y - poses[1]
    distance = np.sqrt(dx * dx + dy * dy)
    # The map's own uncertainty seen from here: isotropic is enough (centimeters).
    spread = 0.5 * (landmark.xx + landmark.yy)
    range_variance = sighting.range_variance + spread
    bearing_variance = sighting.bearing_variance + spread / max(sighting.range_m, 0.3) ** 2
    bearing_error = wrap_all(np.arctan2(dy, dx) - poses[2] - sighting.bearing)
    nis = (distance - sighting.range_m) ** 2 / range_variance + bearing_error**2 / bearing_variance
    gaussian: NDArray[np.float64] = -0.5 * nis
    if landmark.reliability >= 1.0:
        return gaussian
    stray = (1.0 - landmark.reliability) * math.exp(STRAY)
    mixed: NDArray[np.float64] = np.log(landmark.reliability * np.exp(gaussian) + stray)
    return mixed
