"""The observations of the last half minute, related to each other by odometry."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.observations import NEAREST_M, STRAY, Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.localizer.pose_differences import is_another
from cairn.planar.poses import Pose, wrap_all
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]

# NIS: the 99 % and 99.9 % quantiles of chi-square with 2 degrees of freedom, -2 ln 0.01 and
# -2 ln 0.001.
AGREES, CONTRADICTS = 9.2, 13.8
# An object counts as two observations at most: further ones share their error. Chosen by hand;
# `lab/constants.yaml` has the effect of half and double.
OBJECT_WORTH = 2.0
# Objects no farther apart than this [m] are observed in one direction: at 3 m within 11 degrees.
TOGETHER_M = 0.6
# An object that was recognized in less than this share of so many images from one pose was confused
# with another one. A robot that stands never sees it from elsewhere, so it would count for ever.
# After so many images, earlier ones count half: what was hidden for a while counts again soon.
_CONFUSED_SHARE, _CONFUSED_IMAGES, _MOST_IMAGES = 0.1, 20, 200
# Seconds of motion, and observations of each object, that are kept: odometry drifts by 0.16 m and
# 0.27 rad (drift times the root of 30 s), as much as observations err. Drifts [m/sqrt(s)],
# [rad/sqrt(s)]: a little more than those of the parameter `base`.
_HORIZON_S, _PER_OBJECT, _DRIFT, _TURN_DRIFT = 30.0, 4, 0.03, 0.05
# So many poses are compared with the observations at a time. The intermediate results, about ten
# numbers for each pose and observation, then take about 1 MB; for all poses of a global search
# together (up to 200,000) they took hundreds. No result depends on it.
_BLOCK = 512


@dataclass(frozen=True)
class TimedObservation:
    """An observation, the dead-reckoned pose it was made from and the seconds moved until then.

    From about that pose its object was `seen` in so many of so many `images` that showed objects,
    since the first time; earlier ones count less.
    """

    observation: Observation
    at: Pose
    moved_s: float
    seen: float = 1.0
    images: float = 1.0

    def with_image(self) -> TimedObservation:
        """Return it with one more image from that pose."""
        share = 0.5 if self.images >= _MOST_IMAGES else 1.0
        return replace(self, seen=share * self.seen, images=share * self.images + 1.0)

    @property
    def is_confusion(self) -> bool:
        """Whether too few images show the object for it to be there."""
        return self.images >= _CONFUSED_IMAGES and self.seen < _CONFUSED_SHARE * self.images


@dataclass(frozen=True)
class PoseSupport:
    """How many distinct positions of objects agree with a pose, and how many contradict it.

    Objects that stand together (0.6 m) count once: they confirm the same direction only, so a pose
    rotated around them satisfies them all.
    """

    agreeing: int
    contradicting: int

    @property
    def firm(self) -> bool:
        """Whether at least two positions agree, and twice as many as contradict."""
        return self.agreeing >= 2 and self.agreeing >= 2 * self.contradicting


class RecentObservations:
    """Observations during the last `_HORIZON_S` of motion, at most `_PER_OBJECT` of each object.

    Poses are dead-reckoned, in a frame of their own. The variance of an observation grows with the
    motion since then: a little more than in the motion model, so that old observations do not
    outweigh new ones.
    """

    def __init__(self) -> None:
        self.entries: list[TimedObservation] = []

    def clear(self) -> None:
        """Forget everything."""
        self.entries.clear()

    @property
    def farthest_m(self) -> float:
        """The largest range observed [m]; 0 without observations."""
        return max((one.observation.range_m for one in self.entries), default=0.0)

    def add(self, observations: Sequence[Observation], at: Pose, moved_s: float) -> None:
        """Add an image's observations, made from `at`; those of one object only from different
        poses.
        """
        kept = [
            one.with_image() if observations and not is_another(one.at, at) else one
            for one in self.entries
            if moved_s - one.moved_s <= _HORIZON_S
        ]
        for observation in observations:
            new = TimedObservation(observation, at, moved_s)
            same = [e for e in kept if e.observation.object_id == observation.object_id]
            if same and not is_another(same[-1].at, at):
                # The newest pose is better: its odometry has drifted least.
                kept.remove(same[-1])
                new = replace(new, seen=same[-1].seen + 1.0, images=same[-1].images)
            elif len(same) >= _PER_OBJECT:
                kept.remove(same[0])
            kept.append(new)
        self.entries = kept

    def log_likelihood(
        self,
        poses: Array,
        now: Pose,
        moved_s: float,
        landmarks: Mapping[int, Landmark],
        left_out: int | None = None,
        worth: float = OBJECT_WORTH,
    ) -> Array:
        """Return the log-likelihood (n,) of all observations but `left_out`'s if the robot were
        now at `poses`; those of one object count as `worth` observations at most.
        """
        entries = self.usable(landmarks, left_out)
        total = np.zeros(poses.shape[1])
        if not entries:
            return total
        count = Counter(entry.observation.object_id for entry in entries)
        for begin in range(0, poses.shape[1], _BLOCK):
            block = slice(begin, begin + _BLOCK)
            nis = self._nis(poses[:, block], entries, now, moved_s, landmarks, None)
            for row, entry in zip(nis, entries, strict=True):
                key = entry.observation.object_id
                reliability = landmarks[key].reliability
                stray = (1.0 - reliability) * math.exp(STRAY)
                weight = min(1.0, worth / count[key])
                total[block] += weight * np.log(reliability * np.exp(-0.5 * row) + stray)
        return total

    def log_stray(self, landmarks: Mapping[int, Landmark]) -> float:
        """Return the log-likelihood if no object stood where the map says, each counted once."""
        seen = {entry.observation.object_id for entry in self.usable(landmarks)}
        return sum(math.log1p(-landmarks[key].reliability) + STRAY for key in seen)

    def support(
        self,
        pose: PoseEstimate,
        now: Pose,
        moved_s: float,
        landmarks: Mapping[int, Landmark],
        left_out: int | None = None,
    ) -> PoseSupport:
        """Return how many positions of objects (but `left_out`) agree with and contradict
        `pose`.

        What one image alone shows does not contradict: it may be another object.
        """
        entries = self.usable(landmarks, left_out)
        if not entries:
            return PoseSupport(0, 0)
        mean = np.asarray(pose.mean)[:, None]
        nis = self._nis(mean, entries, now, moved_s, landmarks, pose.covariance)[:, 0]
        best: dict[int, list[float]] = {}
        seen: defaultdict[int, float] = defaultdict(float)
        for value, entry in zip(nis, entries, strict=True):
            best.setdefault(entry.observation.object_id, []).append(float(value))
            seen[entry.observation.object_id] += entry.seen
        medians = {key: sorted(values)[len(values) // 2] for key, values in best.items()}
        return PoseSupport(
            _distinct_positions(
                [landmarks[key] for key, value in medians.items() if value <= AGREES]
            ),
            _distinct_positions(
                [
                    landmarks[key]
                    for key, value in medians.items()
                    if value > CONTRADICTS and seen[key] > 1
                ]
            ),
        )

    def usable(
        self, landmarks: Mapping[int, Landmark], left_out: int | None = None
    ) -> list[TimedObservation]:
        """Return those of mapped objects but `left_out`, without confusions, the oldest first."""
        return [
            entry
            for entry in self.entries
            if not entry.is_confusion
            and entry.observation.object_id != left_out
            and entry.observation.object_id in landmarks
            and landmarks[entry.observation.object_id].live
        ]

    def _nis(
        self,
        poses: Array,
        entries: Sequence[TimedObservation],
        now: Pose,
        moved_s: float,
        landmarks: Mapping[int, Landmark],
        covariance: Array | None,
    ) -> Array:
        """Return the NIS (entries, n) of each entry from each pose, with the drift since then."""
        rows = []
        for entry in entries:
            made = entry.observation
            mark = landmarks[made.object_id]
            errors = made.range_variance, made.bearing_variance
            rows.append(
                (*entry.at, entry.moved_s, made.range_m, made.bearing, *errors, mark.x, mark.y)
            )
        # Columns (entries, 1), broadcast over a row of poses.
        x, y, theta, made_at, range_m, bearing, range_variance, bearing_variance, mark_x, mark_y = (
            np.array(rows).T[:, :, None]
        )
        age = moved_s - made_at
        place_variance = _DRIFT**2 * age
        turn_variance = _TURN_DRIFT**2 * age
        if covariance is not None:
            place_variance = place_variance + 0.5 * (covariance[0, 0] + covariance[1, 1])
            turn_variance = turn_variance + covariance[2, 2]
        range_variance = range_variance + place_variance
        reach = np.maximum(range_m, NEAREST_M)
        bearing_variance = bearing_variance + place_variance / reach**2 + turn_variance

        # Where each was made from, relative to now; and from there, what it should have measured.
        along, across = math.cos(now[2]), math.sin(now[2])
        ahead = along * (x - now[0]) + across * (y - now[1])
        aside = along * (y - now[1]) - across * (x - now[0])
        turned = wrap_all(theta - now[2])
        cosine, sine = np.cos(poses[2]), np.sin(poses[2])
        dx = mark_x - (poses[0] + ahead * cosine - aside * sine)
        dy = mark_y - (poses[1] + ahead * sine + aside * cosine)
        error = wrap_all(np.arctan2(dy, dx) - poses[2] - turned - bearing)
        nis: Array = (np.sqrt(dx * dx + dy * dy) - range_m) ** 2 / range_variance
        nis += error**2 / bearing_variance
        return nis


class ConfirmationHistory:
    """Keeps when each object was last observed where a pose that did not rely on it expected it.

    At a wrong pose one object may be observed as expected by chance, two at different positions
    hardly are.
    """

    def __init__(self) -> None:
        self._agreed_at: dict[int, float] = {}
        self.confirmed_until = -math.inf
        """Until when [s] the robot was certainly not lost before its pose was replaced."""

    def add(self, stamp: float, objects: Iterable[int]) -> None:
        """Add the objects that agreed at `stamp` [s]."""
        self._agreed_at |= dict.fromkeys(objects, stamp)

    def on_pose_replaced(self, landmarks: Mapping[int, Landmark]) -> None:
        """Note that the robot was found elsewhere: agreements with the earlier pose end here."""
        self.confirmed_until = max(self.confirmed_until, self._last_confirmed(landmarks))
        self._agreed_at.clear()

    def _last_confirmed(self, landmarks: Mapping[int, Landmark]) -> float:
        """Return the last time [s] since which objects at two positions agreed; -inf if none."""
        newest: Landmark | None = None
        for object_id, stamp in sorted(self._agreed_at.items(), key=lambda one: -one[1]):
            landmark = landmarks.get(object_id)
            if landmark is None:
                continue
            if newest is None:
                newest = landmark
            elif math.hypot(landmark.x - newest.x, landmark.y - newest.y) > TOGETHER_M:
                return stamp
        return -math.inf


def _distinct_positions(objects: Sequence[Landmark]) -> int:
    """Return at how many positions the objects stand; those within 0.6 m of each other count
    once.
    """
    heads: list[Landmark] = []
    for one in objects:
        if all(math.hypot(one.x - head.x, one.y - head.y) > TOGETHER_M for head in heads):
            heads.append(one)
    return len(heads)
