"""Objects that stand a little beside their mapped places, as only many sightings together show."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.localizer.object_likelihood import Landmark, Sighting
from components.localizer.particles import Estimate
from components.localizer.recent import ANOTHER_M, ANOTHER_RAD
from components.localizer.similarity import GATE, MAP_SIGMA, implied_place
from planar.poses import Pose, apart

Array = NDArray[np.float64]

# So many of the newest sightings from different poses are averaged, at least and at most.
_LEAST, _MOST = 6, 12
# What sightings from all poses may have in common by errors of map and pose [m].
_COMMON_M = 0.05
# A shift of less than this [m] is nothing to anybody; one of more is seen from single sightings,
# and what lies farther off than that speaks of something else.
_SMALL_M, _LARGE_M = 0.15, 0.8
# Variance of a median over that of a mean, of many Gaussian numbers.
_MEDIAN = 1.57


@dataclass(frozen=True)
class _Implied:
    """Where a sighting placed its object [m], its own covariance [m^2], and the robot's pose."""

    place: Array
    noise: Array
    seen_from: Pose


class Displacements:
    """The places that the newest sightings of each object imply.

    A single sighting of an object that was moved by a few decimetres agrees with its old place as
    far as its noise goes. The median of several does not.
    """

    def __init__(self) -> None:
        self._implied: dict[int, deque[_Implied]] = {}

    def forget(self, object_id: int) -> None:
        """Drop what was noted of an object, as its place in the map changed."""
        self._implied.pop(object_id, None)

    def shifted(self, sighting: Sighting, pose: Estimate, landmark: Landmark) -> bool:
        """Note a sighting from a sure pose; whether the object clearly stands beside its place."""
        known = self._implied.setdefault(sighting.object_id, deque(maxlen=_MOST))
        x, y, whole = implied_place(pose, sighting)
        if math.hypot(x - landmark.x, y - landmark.y) > _LARGE_M:
            return False
        exact = Estimate(pose.mean, np.zeros((3, 3)))
        noise = implied_place(exact, sighting)[2]
        if not known or apart(known[-1].seen_from, pose.mean, ANOTHER_M, ANOTHER_RAD):
            known.append(_Implied(np.array([x, y]), noise, pose.mean))
        count = len(known)
        if count < _LEAST:
            return False
        off = np.median([one.place for one in known], axis=0) - (landmark.x, landmark.y)
        if math.hypot(*off) < _SMALL_M:
            return False
        mapped = np.array([[landmark.xx, landmark.xy], [landmark.xy, landmark.yy]])
        common = whole - noise + mapped + (_COMMON_M**2 + MAP_SIGMA**2) * np.eye(2)
        total = common + _MEDIAN / count**2 * np.sum([one.noise for one in known], axis=0)
        return float(off @ np.linalg.solve(total, off)) > GATE
