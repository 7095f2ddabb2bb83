"""Which beams of a scan are used, and how much of what they say is new."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.motion import Increment

# Motion after which a scan tells something new [m], [rad]; of one that was taken on the spot
# little counts, as its errors repeat.
_NEW_M, _NEW_RAD, _ON_THE_SPOT = 0.15, 0.15, 0.03


class BeamChoice:
    """At most `most` beams of each scan, and how far the robot has come since the last one."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._far, self._turned = 0.0, 0.0
        self._turn_of_beams = 0

    def moved(self, step: Increment) -> None:
        """Take how the robot moved."""
        self._far += math.hypot(step.ahead, step.aside)
        self._turned += abs(step.turned)

    def chosen(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """At most `most` of the points (m, 2), evenly spaced, others from scan to scan."""
        if len(points) <= self.most:
            return points
        self._turn_of_beams += 1
        begin = (self._turn_of_beams * 0.618) % 1.0
        places = (np.arange(self.most) + begin) * (len(points) / self.most)
        return points[np.minimum(places.astype(np.intp), len(points) - 1)]

    def take_new(self) -> float:
        """The share of a scan that counts as new: the more, the further since the last one."""
        new = self._far / _NEW_M + self._turned / _NEW_RAD
        self._far = self._turned = 0.0
        return min(1.0, max(_ON_THE_SPOT, new))
