"""Monte Carlo localization by recognised objects, and its verdict on each of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from components.localizer.bank import Bank
from components.localizer.judge import Judge, Judgement
from components.localizer.motion import MotionModel, OdometryTrack, move_pose
from components.localizer.object_likelihood import Landmark, Sighting
from components.localizer.particles import Estimate, estimate, normalised, systematic_choice
from components.localizer.recent import Pose, RecentSightings, Support, relative
from components.localizer.search import Found, search

Array = NDArray[np.float64]

# A robot that was found is looked for anew this long [s]: it may have been found in a wrong place
# that explains what little was seen.
PROBATION_S = 30.0
# By so much [nats] another pose must explain the recent sightings better: errors that successive
# sightings have in common are worth 2 to 4.
BETTER = 6.0


@dataclass(frozen=True)
class Settings:
    """What can be tuned; units in the names or in `LocalizerConfig`."""

    particles: int = 400
    judges: int = 16
    search_particles: int = 20_000
    independence: float = 0.15
    mode: Literal["lr", "paper"] = "lr"
    ring_samples: int = 300
    healthy_spread_m: float = 0.35
    motion: MotionModel = field(default_factory=MotionModel)


@dataclass(frozen=True)
class Frame:
    """What one set of sightings gave: the pose before it was fused, health, judgements."""

    before: Estimate
    healthy: bool
    reason: str
    judgements: tuple[Judgement, ...]
    relocalised: bool


class Localization:
    """The robot's pose from commanded velocities and sightings of mapped objects.

    Times are seconds of one clock. Call `command` for each odometry record and `sight` for each
    set of sightings, in the order of their stamps; `located` tells whether there is a pose.
    """

    def __init__(self, settings: Settings, random: np.random.Generator) -> None:
        self.settings = settings
        self.random = random
        self.track = OdometryTrack(settings.motion.lag_s)
        self.bank = Bank(settings.particles, settings.judges, settings.motion, random)
        self.recent = RecentSightings()
        self.judge = Judge(settings.mode, settings.ring_samples, random)
        self.landmarks: dict[int, Landmark] = {}
        self.located = False
        self._reckoned: Pose = (0.0, 0.0, 0.0)
        self._moved_s = 0.0
        self._searched_at = -math.inf
        self._first_seen = math.inf
        self._guess: Estimate | None = None
        self._probation_ends = -math.inf

    def locate(self, pose: Sequence[float], covariance: Array) -> None:
        """Begin (again) from a known pose: x [m], y [m], theta [rad] and covariance (3, 3)."""
        self.bank.scatter(pose, covariance)
        self.recent.clear()
        self.located = True
        self._probation_ends = -math.inf

    def use_map(self, landmarks: Iterable[Landmark]) -> None:
        """Take a new state of the visual map."""
        before = self.landmarks
        self.landmarks = {landmark.object_id: landmark for landmark in landmarks}
        for object_id, old in before.items():
            new = self.landmarks.get(object_id)
            if old.live and (new is None or not new.live):
                # All that it said was said of a place it had left.
                self.bank.believe_without(object_id)
            elif old.live and new is not None and math.hypot(new.x - old.x, new.y - old.y) > 0.3:
                self.judge.forget(object_id)

    def command(self, stamp: float, forward: float, turn: float) -> bool:
        """Take a commanded velocity [m/s, rad/s]; False if it is older than the newest one."""
        return self.track.append(stamp, forward, turn)

    def advance(self, stamp: float) -> None:
        """Move everything to the time `stamp` [s]."""
        step = self.track.advance(stamp)
        self._reckoned = move_pose(self._reckoned, step, self.settings.motion)
        self._moved_s += step.moving_s
        if self.located:
            self.bank.move(step)

    def pose(self) -> Estimate:
        """The pose at the time last advanced to."""
        return self.bank.estimate()

    def ahead(self, pose: Pose, stamp: float) -> Pose:
        """Where a robot that is at `pose` now is expected at the later time `stamp` [s]."""
        return move_pose(pose, self.track.preview(stamp), self.settings.motion)

    def bridge(self, stamp: float, left: Pose, reached: Pose) -> None:
        """Make up for odometry that was missed until `stamp` [s] by the poses it states."""
        self.track.bridge(stamp, relative(left, reached))

    def sight(self, stamp: float, sightings: Sequence[Sighting]) -> Frame | None:
        """Judge and fuse the objects seen at `stamp` [s]; None while the robot is not located."""
        self.advance(stamp)
        live = [s for s in sightings if self._is_live(s.object_id)]
        self.recent.add(sightings, self._reckoned, self._moved_s)
        if not self.located:
            if live:
                self._first_seen = min(self._first_seen, stamp)
                self._find(stamp)
            return None
        for sighting in live:
            self.bank.watch(sighting.object_id)
        before = self.bank.estimate()
        support = self._support(before, None)
        healthy, reason = self._health(before, support)
        judgements = tuple(self._judge(sighting, before, healthy) for sighting in sightings)
        if live:
            self.bank.fuse(live, self.landmarks, self.settings.independence)
        relocalised = False
        since = stamp - self._searched_at
        on_probation = stamp < self._probation_ends
        if (since >= 1.0 and any(j.contradicts for j in judgements)) or (
            since >= 2.0 and on_probation
        ):
            relocalised = self._recover(stamp)
        return Frame(before, healthy, reason, judgements, relocalised)

    def _is_live(self, object_id: int) -> bool:
        landmark = self.landmarks.get(object_id)
        return landmark is not None and landmark.live

    def _support(self, pose: Estimate, left_out: int | None) -> Support:
        return self.recent.support(pose, self._reckoned, self._moved_s, self.landmarks, left_out)

    def _health(self, pose: Estimate, support: Support) -> tuple[bool, str]:
        limit = self.settings.healthy_spread_m
        if pose.spread > limit:
            return False, f"the pose is uncertain by {pose.spread:.2f} m (limit {limit:.2f} m)"
        if not support.firm:
            return False, (
                f"of the places seen of late {support.agreeing} agree with the pose and "
                f"{support.contradicting} contradict it"
            )
        return True, ""

    def _judge(self, sighting: Sighting, before: Estimate, healthy: bool) -> Judgement:
        object_id = sighting.object_id
        if not self._is_live(object_id):
            return self.judge.place(sighting, before, healthy)
        pose = self.bank.estimate_without(object_id)
        return self.judge.compare(
            sighting,
            pose,
            self.landmarks,
            self._support(pose, object_id),
            pose.spread <= self.settings.healthy_spread_m,
            lambda poses: self.recent.log_likelihood(
                poses, self._reckoned, self._moved_s, self.landmarks, object_id
            ),
        )

    def _search(self) -> Found | None:
        return search(
            self.recent,
            self._reckoned,
            self._moved_s,
            self.landmarks,
            self.settings.search_particles,
            self.random,
        )

    def _find(self, stamp: float) -> None:
        if stamp - self._searched_at < 0.5:
            return
        self._searched_at = stamp
        found = self._search()
        if found is None or found.support.contradicting >= max(1, found.support.agreeing):
            self._guess = None
            return
        waited = stamp - self._first_seen
        if found.share >= 0.9 and (found.support.agreeing >= 2 or waited >= 15.0):
            # Two modes take turns while little was seen: believe the one that stays.
            if self._guess is not None and _close(self._guess, found.pose):
                self._settle(found.poses)
                self._probation_ends = stamp + PROBATION_S
            self._guess = found.pose
        elif waited >= 10.0 and _whole(found.everywhere).spread < 0.8:
            # One place alone leaves an arc around it open; its width is stated, and the filter
            # narrows it sooner than waiting does.
            self._settle(found.everywhere)
            self._probation_ends = stamp + PROBATION_S

    def _recover(self, stamp: float) -> bool:
        self._searched_at = stamp
        found = self._search()
        if found is None or found.share < 0.8 or found.pose.spread > 0.5:
            return False
        if found.support.agreeing < 2 or found.support.contradicting > found.support.agreeing:
            return False
        here = self.bank.estimate()
        if _close(here, found.pose):
            return False
        mean = np.asarray(here.mean)[:, None]
        score = self.recent.log_likelihood(mean, self._reckoned, self._moved_s, self.landmarks)
        if found.score - float(score[0]) < BETTER:
            return False
        self._settle(found.poses)
        return True

    def _settle(self, poses: Array) -> None:
        equal = normalised(np.zeros(poses.shape[1]))
        chosen = systematic_choice(equal, self.settings.particles, self.random)
        self.bank.settle(poses[:, chosen])
        self.located = True


def _whole(poses: Array) -> Estimate:
    return estimate(poses, np.zeros(poses.shape[1]))


def _close(a: Estimate, b: Estimate) -> bool:
    turn = (a.mean[2] - b.mean[2] + math.pi) % (2.0 * math.pi) - math.pi
    return math.hypot(a.mean[0] - b.mean[0], a.mean[1] - b.mean[1]) < 0.5 and abs(turn) < 0.35
