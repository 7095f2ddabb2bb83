"""Objects that stand a little beside their mapped places, as only many sightings together show."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.object_likelihood import Landmark, Sighting
from cairn.components.localizer.particles import Estimate
from cairn.components.localizer.recent import ANOTHER_M, ANOTHER_RAD
from cairn.components.localizer.similarity import GATE, MAP_SIGMA, implied_place
from cairn.planar.poses import Pose, apart

Array = NDArray[np.float64]

# So many of the newest sightings from different poses are averaged: few tell soon of a large shift,
# many of a small one.
_WINDOWS = (6, 10, 20)
# What sightings from all poses may have in common by errors of map and pose [m].
_COMMON_M = 0.05
# A shift of less than this [m] is nothing to anybody; one of more is seen from single sightings,
# and what lies farther off than that speaks of something else.
_SMALL_M, _LARGE_M = 0.15, 0.8


@dataclass(frozen=True)
class _Implied:
    """Where a sighting placed its object [m], its own covariance [m^2], and the robot's pose."""

    place: Array
    noise: Array
    seen_from: Pose


class Displacements:
    """The places that the newest sightings of each object imply.

    A single sighting of an object that was moved by a few decimeters agrees with its old place as
    far as its noise goes. The mean of several does not.
    """

    def __init__(self) -> None:
        self._implied: dict[int, deque[_Implied]] = {}

    def forget(self, object_id: int) -> None:
        """Drop what was noted of an object, as its place in the map changed."""
        self._implied.pop(object_id, None)

    def clear(self) -> None:
        """Drop everything, as the robot was somewhere else."""
        self._implied.clear()

    def shifted(self, sighting: Sighting, pose: Estimate, landmark: Landmark) -> bool:
        """Note a sighting from a sure pose; whether the object clearly stands beside its place."""
        known = self._implied.setdefault(sighting.object_id, deque(maxlen=_WINDOWS[-1]))
        x, y, whole = implied_place(pose, sighting)
        if math.hypot(x - landmark.x, y - landmark.y) > _LARGE_M:
            return False
        exact = Estimate(pose.mean, np.zeros((3, 3)))
        noise = implied_place(exact, sighting)[2]
        if not known or apart(known[-1].seen_from, pose.mean, ANOTHER_M, ANOTHER_RAD):
            known.append(_Implied(np.array([x, y]), noise, pose.mean))
        mapped = np.array([[landmark.xx, landmark.xy], [landmark.xy, landmark.yy]])
        common = whole - noise + mapped + (_COMMON_M**2 + MAP_SIGMA**2) * np.eye(2)
        there = np.array([landmark.x, landmark.y])
        windows = [list(known)[-count:] for count in _WINDOWS if count <= len(known)]
        return any(_beside(_agreed(window), there, common) for window in windows)


@dataclass(frozen=True)
class _Agreed:
    """The weighted mean of implied places [m], and its covariance [m^2]."""

    place: Array
    noise: Array


def _beside(agreed: _Agreed | None, there: Array, common: Array) -> bool:
    if agreed is None:
        return False
    off = agreed.place - there
    far = math.hypot(*off) >= _SMALL_M
    return far and float(off @ np.linalg.solve(common + agreed.noise, off)) > GATE


def _agreed(implied: list[_Implied]) -> _Agreed | None:
    """What the implied places agree on, all but one in six; None if they do not."""
    mean = _weighted_mean(implied)
    kept = [one for one in implied if _squared_distance(one, mean) <= GATE]
    return _weighted_mean(kept) if 6 * len(kept) >= 5 * len(implied) else None


def _weighted_mean(implied: list[_Implied]) -> _Agreed:
    information = [np.linalg.inv(one.noise) for one in implied]
    noise = np.linalg.inv(np.sum(information, axis=0))
    weighted = [of_one @ one.place for of_one, one in zip(information, implied, strict=True)]
    return _Agreed(noise @ np.sum(weighted, axis=0), noise)


def _squared_distance(one: _Implied, mean: _Agreed) -> float:
    off = one.place - mean.place
    total = one.noise + mean.noise + _COMMON_M**2 * np.eye(2)
    return float(off @ np.linalg.solve(total, off))
