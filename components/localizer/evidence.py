"""All that the robot saw of late, as one question: how well does a pose explain it?"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.object_likelihood import Landmark
from cairn.components.localizer.particles import Estimate
from cairn.components.localizer.recent import RecentSightings, Support
from cairn.components.localizer.recent_scans import RecentScans
from cairn.components.localizer.scan_map import ScanMap
from cairn.planar.poses import Pose

Array = NDArray[np.float64]

_LOOSE = 4  # of more scans a pose that is a little off explains nothing


@dataclass(frozen=True)
class Evidence:
    """Recent sightings and scans, seen from the dead-reckoned pose `now`.

    `map` is None without a grid map; a scan counts `scan_share` of its log-likelihood.
    """

    sightings: RecentSightings
    scans: RecentScans
    landmarks: Mapping[int, Landmark]
    map: ScanMap | None
    scan_share: float
    now: Pose
    moved_s: float

    @property
    def scanned(self) -> bool:
        """Whether there are scans to go by."""
        return self.map is not None and len(self.scans) > 0

    def log_likelihood(self, poses: Array, left_out: int | None = None) -> Array:
        """Log-likelihood (n,) of everything but object `left_out`, were the robot at `poses`."""
        total = self.sightings.log_likelihood(
            poses, self.now, self.moved_s, self.landmarks, left_out
        )
        if self.map is not None:
            total += self.scan_share * self.scans.log_likelihood(
                poses, self.now, self.map.field.log_likelihood, None
            )
        return total

    def loose(self, poses: Array) -> Array:
        """The same of the newest scans, taken loosely, so that poses nearby explain them: (n,)."""
        return self._loosely(poses, _LOOSE)

    def first_look(self, poses: Array) -> Array:
        """The same of the sightings and the newest scan alone: (n,)."""
        return self._loosely(poses, 1)

    def fit(self, pose: Estimate) -> float:
        """Share of the scans' beams that the map explains from a pose; NaN without scans."""
        if self.map is None:
            return math.nan
        return self.scans.fit(pose.mean, self.now, self.map.field)

    def support(self, pose: Estimate, left_out: int | None = None) -> Support:
        """How many places of objects agree with a pose, and how many contradict it."""
        return self.sightings.support(pose, self.now, self.moved_s, self.landmarks, left_out)

    def _loosely(self, poses: Array, newest: int) -> Array:
        total = self.sightings.log_likelihood(poses, self.now, self.moved_s, self.landmarks)
        if self.map is not None:
            total += self.scan_share * self.scans.log_likelihood(
                poses, self.now, self.map.wide.log_likelihood, newest
            )
        return total
