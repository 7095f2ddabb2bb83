"""The last scans from different poses, tied together by odometry: what a pose must explain."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.recent import carry
from cairn.planar.poses import Pose, compose, distance, relative, wrap

Array = NDArray[np.float64]


class RecentScans:
    """End points of the `keep` newest scans that were taken `apart_m` or `turned` [rad] apart."""

    def __init__(self, keep: int = 8, apart_m: float = 0.3, turned: float = 0.35) -> None:
        self.keep = keep
        self.apart_m, self.turned = apart_m, turned
        self._scans: deque[tuple[Array, Pose]] = deque()

    def __len__(self) -> int:
        return len(self._scans)

    def clear(self) -> None:
        """Forget all."""
        self._scans.clear()

    def add(self, points: Array, at: Pose) -> None:
        """Keep a scan's end points (m, 2), taken at the dead-reckoned pose `at`.

        It stands for the last one as long as the robot has not moved apart from the one before.
        """
        if len(self._scans) >= 2 and not self._apart(self._scans[-2][1], self._scans[-1][1]):
            self._scans.pop()
        elif len(self._scans) == self.keep:
            self._scans.popleft()
        self._scans.append((points, at))

    def log_likelihood(
        self, poses: Array, now: Pose, each: Callable[[Array, Array], Array], newest: int | None
    ) -> Array:
        """Sum over the scans (or the `newest` of them) of `each(poses, points)`, were the robot
        now at `poses` (3, n).
        """
        total = np.zeros(poses.shape[1])
        scans = list(self._scans)[-newest:] if newest else self._scans
        for points, at in scans:
            total += each(carry(poses, relative(now, at)), points)
        return total

    def fit(self, pose: Pose, now: Pose, field: LikelihoodField) -> float:
        """Share of the scans' end points that lie near an obstacle, were the robot at `pose`."""
        if not self._scans:
            return math.nan
        shares = [field.fit(compose(pose, relative(now, at)), points) for points, at in self._scans]
        return float(np.mean(shares))

    def _apart(self, a: Pose, b: Pose) -> bool:
        return distance(a, b) > self.apart_m or abs(wrap(a[2] - b[2])) > self.turned
