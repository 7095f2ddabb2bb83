"""Scans: which beams are used, the recent scans, and how well the map explains them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.health import FITS, SILENT_S
from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.odometry import OdometryStep
from cairn.components.localizer.particle_set import carry
from cairn.planar.poses import Pose, compose, distance, relative, wrap

Array = NDArray[np.float64]

# Motion after which a scan tells something new [m], [rad]; of one that was taken on the spot
# little counts, as its errors repeat.
_NEW_M, _NEW_RAD, _ON_THE_SPOT = 0.15, 0.15, 0.03


class BeamSelector:
    """At most `most` beams of each scan, and how far the robot has come since the last one."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._far, self._turned = 0.0, 0.0
        self._turn_of_beams = 0

    def moved(self, step: OdometryStep) -> None:
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

    def take_share_of_new(self) -> float:
        """The share of a scan that counts as new: the more, the further since the last one."""
        new = self._far / _NEW_M + self._turned / _NEW_RAD
        self._far = self._turned = 0.0
        return min(1.0, max(_ON_THE_SPOT, new))


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


# Share of the newest scan in the running mean.
_NEWEST = 0.2
# About so many rays that hit nothing are followed through the map.
_RAYS = 60


class ScanFit:
    """Running mean of the share (0 to 1) of a scan's beams that the map explains; None at first.

    A ray that hit nothing counts where the map has nothing either. Else it tells nothing, as glass
    and what is dark return no beam, unless no ray of the scan hits anything.
    """

    def __init__(self) -> None:
        self.value: float | None = None
        self._at = -math.inf
        self.contradicted = False
        """Whether the newest scan hit nothing where the map has obstacles."""

    def vouches(self, now: float) -> bool:
        """Whether scans fit well enough to speak for a pose at `now` [s], and still come."""
        return self.value is not None and self.value >= FITS and now - self._at <= SILENT_S

    def forget(self) -> None:
        """Begin anew: the robot is somewhere else."""
        self.value = None

    def note(
        self,
        stamp: float,
        field: LikelihoodField,
        pose: Pose,
        hits: Array,
        count: int,
        starts: Array,
        ends: Array,
    ) -> None:
        """Take a scan of `stamp` [s], seen from a pose: some `hits` (m, 2) [m] of `count`, and the
        `starts` and `ends` (k, 2) [m] of the rays that hit nothing.
        """
        self._at = stamp
        some = slice(None, None, 1 + len(starts) // _RAYS)
        clear = len(starts) * field.clear(pose, starts[some], ends[some]) if len(starts) else 0.0
        explained = count * field.fit(pose, hits) if count else 0.0
        self.contradicted = not count and clear < 0.5 * len(starts)
        if count + clear > 0:
            fit = (explained + clear) / (count + clear)
            before = fit if self.value is None else self.value
            self.value = before + _NEWEST * (fit - before)
