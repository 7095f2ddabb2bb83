"""Scans: which beams are used, the recent scans, and how well the map explains them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.particle_set import carry
from cairn.components.localizer.pose_differences import ANOTHER_M, LEVER_M, is_same
from cairn.components.localizer.pose_health import FITS, SILENT_S
from cairn.planar.motion_model import OdometryStep
from cairn.planar.poses import Pose, compose, relative

Array = NDArray[np.float64]

# Of the logs fr101 and fr079, half and double of the next constants change the median error by at
# most 2 mm (benchmark `localization_logs`). With half of `_ON_THE_SPOT`, or double of the others,
# fr079 was 11.6 m off for a while, as it was with the present values and another seed (2).

# Of a scan taken on the spot this share counts, as its errors repeat.
_ON_THE_SPOT = 0.03
# The golden ratio: successive starts spread evenly over the beams.
_GOLDEN = 0.618
# Weight of the newest scan in the running mean of the fit: a mean over five scans.
_NEWEST = 0.2
# Weight of the newest scan in the usual fit, a mean over 50 scans; a smaller one if it fits worse
# than 0.8 of that, so that a carried robot does not get used to its wrong position for 1,000 scans.
# Chosen by hand; `lab/constants.yaml` has the effect of half and double.
_USUAL_NEWEST, _USUAL_NEWEST_OF_BAD, _USUAL_BAD = 0.02, 0.001, 0.8
# About so many rays that hit nothing are traced through the map: as many as the parameter `beams`.
_TRACED_RAYS = 60
# So many poses are compared with a scan at a time, so that intermediate results take 0.5 MB and not
# several for all poses of a global search. No result depends on it.
_BLOCK = 8192
# Scans indicate that the robot is lost if they fit less than the first share, or less than the
# second share of their usual fit; they fit well from the third share of it on.
_LOST_FIT, _LOST_OF_USUAL, _WELL_OF_USUAL = 0.5, 0.65, 0.9
# They stopped fitting at once if the robot drove less than this since they fitted well [m].
_AT_ONCE_M = 0.3
# So many scans of different places are kept for the search: they cover 2 m of the way, or nearly
# half a turn.
_KEPT = 8


class BeamSelector:
    """Selects at most `most` beams of each scan, and measures the motion between scans."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._moved_m, self._turned_rad = 0.0, 0.0
        self._scans = 0

    def add_motion(self, step: OdometryStep) -> None:
        """Add a step of odometry."""
        self._moved_m += math.hypot(step.ahead, step.aside)
        self._turned_rad += abs(step.turned)

    def select(self, points: Array) -> Array:
        """Return at most `most` of the points (m, 2), evenly spaced, others in each scan."""
        if len(points) <= self.most:
            return points
        self._scans += 1
        start = (self._scans * _GOLDEN) % 1.0
        indices = (np.arange(self.most) + start) * (len(points) / self.most)
        return points[np.minimum(indices.astype(np.intp), len(points) - 1)]

    def take_share_of_new(self) -> float:
        """Return the share of a scan that counts as new: it grows with the motion since the last.

        Resets the motion.
        """
        share = (self._moved_m + LEVER_M * self._turned_rad) / ANOTHER_M
        self._moved_m = self._turned_rad = 0.0
        return min(1.0, max(_ON_THE_SPOT, share))


def way_of(step: OdometryStep) -> float:
    """Return by how many meters a step of odometry changes what the scanner sees."""
    return math.hypot(step.ahead, step.aside) + LEVER_M * abs(step.turned)


class RecentScans:
    """End points of the `keep` newest scans taken at different places."""

    def __init__(self, keep: int = _KEPT) -> None:
        self.keep = keep
        self._scans: deque[tuple[Array, Pose]] = deque()

    def __len__(self) -> int:
        return len(self._scans)

    def clear(self) -> None:
        """Forget all scans."""
        self._scans.clear()

    def add(self, points: Array, at: Pose) -> None:
        """Add a scan's end points (m, 2), taken at the dead-reckoned pose `at`.

        It replaces the last one as long as that was not taken apart from the one before.
        """
        if len(self._scans) >= 2 and is_same(self._scans[-2][1], self._scans[-1][1]):
            self._scans.pop()
        elif len(self._scans) == self.keep:
            self._scans.popleft()
        self._scans.append((points, at))

    @property
    def way_m(self) -> float:
        """By how many meters what the scanner saw has changed from the first scan to the last."""
        poses = [at for _, at in self._scans]
        steps = [relative(a, b) for a, b in pairwise(poses)]
        return sum(math.hypot(x, y) + LEVER_M * abs(turn) for x, y, turn in steps)

    def log_likelihood(
        self, poses: Array, now: Pose, each: Callable[[Array, Array], Array], newest: int | None
    ) -> Array:
        """Return the sum over the scans (or the `newest` of them) of `each(poses, points)`.

        The robot is assumed to be now at `poses` (3, n); `now` is the dead-reckoned pose.
        """
        total = np.zeros(poses.shape[1])
        scans = list(self._scans)[-newest:] if newest else self._scans
        for begin in range(0, poses.shape[1], _BLOCK):
            block = slice(begin, begin + _BLOCK)
            for points, at in scans:
                total[block] += each(carry(poses[:, block], relative(now, at)), points)
        return total

    def fit(self, pose: Pose, now: Pose, field: LikelihoodField) -> float:
        """Return the share of the end points near an obstacle if the robot is at `pose`."""
        if not self._scans:
            return math.nan
        shares = [field.fit(compose(pose, relative(now, at)), points) for points, at in self._scans]
        return float(np.mean(shares))


class ScanFit:
    """Running mean of the share (0 to 1) of a scan's beams that the map explains; None at first.

    A ray that hit nothing counts as explained where the map has nothing either. Otherwise it is
    ignored, as glass and dark surfaces return no beam, unless no ray of the scan hits anything.
    """

    def __init__(self) -> None:
        self.value: float | None = None
        self.usual: float | None = None
        """The same over more scans, and hardly changed by scans that fit badly."""
        self.contradicted = False
        """Whether the newest scan hit nothing where the map has obstacles."""
        self._updated_at = -math.inf
        self._way_m = 0.0  # since scans fitted well

    def supports(self, now: float) -> bool:
        """Whether scans fit well enough to support a pose at `now` [s], and still arrive."""
        fits = self.value is not None and self.value >= FITS
        return fits and now - self._updated_at <= SILENT_S

    @property
    def lost(self) -> bool:
        """Whether scans indicate that the robot is lost."""
        limit = max(_LOST_FIT, _LOST_OF_USUAL * (self.usual or 0.0))
        return self.value is not None and self.value < limit

    @property
    def lost_at_once(self) -> bool:
        """Whether scans stopped fitting at once, as when the robot is carried away."""
        return self.lost and self._way_m < _AT_ONCE_M

    def reset(self) -> None:
        """Start again: the robot is somewhere else."""
        self.value, self._way_m = None, 0.0

    def as_usual(self, fit: float) -> bool:
        """Whether scans that fit by this share fit about as well as they usually do."""
        return fit >= _WELL_OF_USUAL * (self.usual or 0.0)

    def add_motion(self, step: OdometryStep) -> None:
        """Add a step of odometry."""
        if not self.lost:
            self._way_m += way_of(step)

    def update(
        self,
        stamp: float,
        field: LikelihoodField,
        pose: Pose,
        hits: Array,
        count: int,
        starts: Array,
        ends: Array,
        new: float = 1.0,
    ) -> None:
        """Add a scan of `stamp` [s] taken from a pose, of which the share `new` is new.

        `hits` (m, 2) [m] are a selection of `count` end points; `starts` and `ends` (k, 2) [m] are
        those of the rays that hit nothing.
        """
        self._updated_at = stamp
        some = slice(None, None, 1 + len(starts) // _TRACED_RAYS)
        clear = len(starts) * field.clear(pose, starts[some], ends[some]) if len(starts) else 0.0
        explained = count * field.fit(pose, hits) if count else 0.0
        self.contradicted = not count and clear < 0.5 * len(starts)
        if count + clear > 0:
            fit = (explained + clear) / (count + clear)
            before = fit if self.value is None else self.value
            self.value = before + _NEWEST * (fit - before)
            usual = fit if self.usual is None else self.usual
            newest = _USUAL_NEWEST if fit >= _USUAL_BAD * usual else _USUAL_NEWEST_OF_BAD
            self.usual = usual + new * newest * (self.value - usual)
            if self.as_usual(self.value):
                self._way_m = 0.0
