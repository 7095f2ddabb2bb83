"""Places in the map; two as one: how likely that is, and what they make together."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Density [1/m^2] of a sighting of an object that stands anywhere in view: 4 m by 60 degrees.
CLUTTER = 1.0 / (0.5 * 4.0**2 * math.radians(60.0))
# A sighting's share of the robot's own error, which all its sightings of an hour have in common.
COMMON_ERROR = 0.15  # [m]


@dataclass(frozen=True)
class Place:
    """A place in the map [m] and its covariance [m^2]."""

    x: float
    y: float
    xx: float
    xy: float
    yy: float

    def distance(self, other: Place) -> float:
        """Meters between two places."""
        return math.hypot(self.x - other.x, self.y - other.y)


def place_similarity(candidate: Place, implied: Place) -> float:
    """Odds that two implied places are one, against a sighting anywhere in view; in [0.1, 0.9]."""
    total = _together(candidate, implied)
    nis = squared_distance(candidate, implied)
    density = math.exp(-0.5 * nis) / (2.0 * math.pi * math.sqrt(float(np.linalg.det(total))))
    return min(0.9, max(0.1, density / (density + CLUTTER)))


def squared_distance(one: Place, other: Place) -> float:
    """The distance of two places, squared and in units of their covariances [1]."""
    error = np.array([other.x - one.x, other.y - one.y])
    return float(error @ np.linalg.solve(_together(one, other), error))


def fuse(place: Place, implied: Place) -> Place:
    """Kalman update of a place by an implied place, whose error the robot's pose has part in."""
    prior = _covariance(place)
    noise = _covariance(implied) + COMMON_ERROR**2 * np.eye(2)
    gain = prior @ np.linalg.inv(prior + noise)
    x, y = np.array([place.x, place.y]) + gain @ np.array(
        [implied.x - place.x, implied.y - place.y]
    )
    left = (np.eye(2) - gain) @ prior
    return Place(
        float(x),
        float(y),
        float(left[0, 0]),
        float(0.5 * (left[0, 1] + left[1, 0])),
        float(left[1, 1]),
    )


def average(place: Place, sightings: int, implied: Place) -> Place:
    """The mean of a place that `sightings` told of and of another, implied place.

    Those of a few seconds are told from the same errors of the robot's pose: none is worth more
    than another, but together they are not much surer than one.
    """
    fused, share = fuse(place, implied), 1.0 / (sightings + 1)
    x = place.x + share * (implied.x - place.x)
    y = place.y + share * (implied.y - place.y)
    return replace(fused, x=x, y=y)


def _together(one: Place, other: Place) -> Array:
    return _covariance(one) + _covariance(other) + 0.06**2 * np.eye(2)


def _covariance(place: Place) -> Array:
    return np.array([[place.xx, place.xy], [place.xy, place.yy]])
