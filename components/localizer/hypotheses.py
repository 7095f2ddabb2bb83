"""Where else the robot may be: hypotheses that are carried on and judged by all evidence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.global_search import (
    CORRELATED_M,
    MODES,
    MOMENT,
    PARTICLES,
    SEARCH_SHARE,
    GlobalSearchResult,
    RecentMeasurements,
    search,
)
from cairn.components.localizer.particle_set import (
    ParticleSet,
    PoseEstimate,
    estimate,
)
from cairn.components.localizer.pose_differences import (
    is_elsewhere,
    is_same,
    slip_covariance,
)
from cairn.components.localizer.pose_health import FITS
from cairn.components.localizer.scan_fit import ScanFit, way_of
from cairn.planar.motion_model import MotionModel, OdometryStep
from cairn.planar.poses import Pose, wrap

Array = NDArray[np.float64]

# Logarithm of how likely it is that the robot was carried away when a search looks for it, if
# nothing suggests that; if the scans stopped fitting at once; and that its wheels slipped, when
# scans fit badly.
_CARRIED, _CARRIED_AT_ONCE, _SLIPPED = -9.0, -5.0, -4.0
# A pose that was found just now is as likely as others that explain the measurements as well.
# It is kept against them as any other after so much of the way [m]; searches check it until then.
_SETTLED_M = 10.0
GOOD_FIT = 0.8
"""A scan of which the map explains this share or more does not indicate a slip."""
# So many hypotheses are kept besides the current one.
_MOST = 12
# A pose is replaced when another one is so much likelier (logarithm of odds), and when that one is
# so probable (0 to 1) against all others. From the third on the robot is certainly not there: any
# likely position is a better one to go on from. Those less likely than the best by more than the
# last are dropped.
_BETTER, _LIKELY, _REFUTED, _UNLIKELY = math.log(9.0), 0.9, 15.0, 12.0
MOST_DOUBT = 0.01
"""From this probability of other positions on, the pose is not confirmed.

One object that agrees by chance does not suffice to confirm it.
"""
# Periods of the search [s]: of a robot that is not located; that is probably lost; that was found
# just now; and of one whose scans fit by less than `GOOD_FIT`.
_UNKNOWN_EVERY_S, _LOST_EVERY_S, _FOUND_EVERY_S, _DOUBTFUL_EVERY_S = 0.5, 1.0, 2.0, 3.0
# Without scans, a robot waits so long [s] for a second object before it believes a result by one
# object; or for the particles around the only object to narrow to this spread [m].
_WAIT_FOR_SECOND_S, _WAIT_FOR_SPREAD_S, _ONE_OBJECT_SPREAD_M = 15.0, 10.0, 0.8


@dataclass
class Hypothesis:
    """Where the robot may be.

    `odds` is the logarithm of how much likelier than the current pose scans make it; of a robot
    that is not located, than the likeliest. `searches` have found it so often.
    """

    particles: ParticleSet
    odds: float
    searches: int = 1

    @property
    def pose(self) -> Pose:
        """The mean of its particles."""
        return self.particles.estimate().mean


@dataclass(frozen=True)
class Alternative:
    """Another position at which the robot may be, and how probable it is (0 to 1)."""

    pose: Pose
    probability: float


class PoseHypotheses:
    """The poses besides the current one at which the robot may be.

    A hypothesis arises from a search: of the whole map, or around the current pose. It begins with
    the odds of the event that could have brought the robot there, against the number of positions
    to which it could have. From then on it is carried on by odometry like the current pose, and
    each scan changes its odds, by as much as the scan is new. What objects say is that of the
    recent observations.
    """

    def __init__(
        self, search_particles: int, motion: MotionModel, random: np.random.Generator
    ) -> None:
        self.search_particles = search_particles
        self.motion = motion
        self.random = random
        self.others: list[Hypothesis] = []
        self._last: GlobalSearchResult | None = None
        self._searched_at = -math.inf
        self._first_measured = math.inf
        self._way_m = 0.0  # since the last scan
        self._settled_m = math.inf  # the way since the pose was found

    def clear(self) -> None:
        """Forget all hypotheses: the robot's pose is known."""
        self.others.clear()
        self._last = None
        self._settled_m = math.inf

    def search_due(self, stamp: float, fit: ScanFit, contradicted: bool) -> bool:
        """Whether a located robot searches the map at `stamp` [s].

        `contradicted`: an object observed just now contradicts its pose.
        """
        since = stamp - self._searched_at
        if contradicted or fit.lost:
            return since >= _LOST_EVERY_S
        if self._settled_m < _SETTLED_M:
            return since >= _FOUND_EVERY_S
        return fit.value is not None and fit.value < GOOD_FIT and since >= _DOUBTFUL_EVERY_S

    def find(self, stamp: float, recent: RecentMeasurements) -> Array | None:
        """Return poses (3, n) of a robot whose position is unknown; None while it is ambiguous."""
        self._first_measured = min(self._first_measured, stamp)
        if stamp - self._searched_at < _UNKNOWN_EVERY_S:
            return None
        self.search(stamp, recent, None)
        found = self._last
        if found is None:
            return None
        if recent.scanned:
            return self._take_likely(recent)
        agreeing = found.support.agreeing
        if found.support.contradicting >= max(1, agreeing):
            return None
        waited = stamp - self._first_measured
        again = any(one.searches > 1 and is_same(one.pose, found.pose.mean) for one in self.others)
        firm = agreeing >= 2 or waited >= _WAIT_FOR_SECOND_S
        if found.share >= _LIKELY and firm:
            return found.modes[0] if again else None
        spread = estimate(found.everywhere, np.zeros(found.everywhere.shape[1])).spread
        if waited >= _WAIT_FOR_SPREAD_S and spread < _ONE_OBJECT_SPREAD_M:
            # One object alone leaves an arc around it open; its width is published, and the filter
            # narrows it sooner than waiting does.
            return found.everywhere
        return None

    def on_found(self) -> None:
        """Note that the robot's pose is that of a hypothesis from now on."""
        self._settled_m = 0.0

    def found_here(self, stamp: float, here: PoseEstimate) -> bool:
        """Whether the last search before `stamp` [s] clearly found the robot at its pose."""
        last = self._last
        return (
            last is not None
            and stamp - self._searched_at <= _DOUBTFUL_EVERY_S
            and last.share >= _LIKELY
            and is_same(last.pose.mean, here.mean)
        )

    def move(self, step: OdometryStep) -> None:
        """Carry on all hypotheses by a step of odometry."""
        way = way_of(step)
        self._way_m += way
        self._settled_m += way
        for one in self.others:
            one.particles.move(step)

    def add_scan(
        self,
        log_likelihood: Callable[[Array], Array],
        hidden: Callable[[Pose], float],
        here: ParticleSet | None,
    ) -> None:
        """Judge the hypotheses by a scan, relative to the current pose, if there is one.

        `log_likelihood` returns what counts of the scan (n,) for poses (3, n) as new, `hidden` by
        how much less it is at a pose, as beams would have passed walls.
        """
        way, self._way_m = self._way_m, 0.0
        if not self.others:
            return
        worth = SEARCH_SHARE * MOMENT * way / CORRELATED_M

        def evidence(particles: ParticleSet) -> float:
            """Return the logarithm of the mean likelihood of the scan over the particles."""
            weighed = particles.log_weights + log_likelihood(particles.poses)
            mean = np.logaddexp.reduce(weighed) - np.logaddexp.reduce(particles.log_weights)
            return float(mean) + hidden(particles.estimate().mean)

        base = evidence(here) if here is not None else 0.0
        for one in self.others:
            one.odds += worth * (evidence(one.particles) - base)

    def fuse(self, log_likelihood: Callable[[Array], Array]) -> None:
        """Move the particles of all hypotheses to where a measurement fits."""
        for one in self.others:
            one.particles.fuse(log_likelihood)

    def search(
        self,
        stamp: float,
        recent: RecentMeasurements,
        here: PoseEstimate | None,
        at_once: bool = False,
    ) -> None:
        """Search the whole map at `stamp` [s] for hypotheses besides the current pose `here`.

        `at_once`: scans stopped fitting at once, as when the robot is carried away.
        """
        self._searched_at = stamp
        known = np.array([one.pose for one in self.others]).T if self.others else None
        found = self._last = search(recent, self.search_particles, self.random, known)
        if found is None:
            return
        means = [estimate(mode, np.zeros(mode.shape[1])).mean for mode in found.modes]
        by_scans = recent.scan_worth(np.array(means).T)
        if here is not None:
            base = float(recent.scan_worth(np.array([here.mean]).T)[0])
            carried = _CARRIED_AT_ONCE if at_once else _CARRIED
            prior = (carried - math.log(recent.places)) * min(1.0, self._settled_m / _SETTLED_M)
        else:
            base, prior = self._base(recent, by_scans), 0.0
        odds = prior + by_scans - base
        for mode, pose, value in zip(found.modes, means, odds, strict=True):
            if here is not None and is_same(pose, here.mean):
                continue
            known_one = next((one for one in self.others if is_same(pose, one.pose)), None)
            if known_one is None:
                self._add(mode, float(value))
            else:
                known_one.searches += 1
                if here is not None:
                    # It could have been carried there just now.
                    known_one.odds = max(known_one.odds, float(value))
        self._keep_likely(recent, here)

    def search_near(
        self,
        here: PoseEstimate,
        log_likelihood: Callable[[Array], Array],
        fits: Callable[[Pose], bool],
    ) -> None:
        """Search around the current pose: wheels may have slipped, or the robot was pushed.

        The motion model covers errors that accumulate slowly. A slip is off by many times as much
        at once, and then no particle is right. `log_likelihood` is as in `add_scan`; a slip
        explains the scan only if it `fits` there as scans usually do.
        """
        # As many poses as a search draws for each place.
        most = max(PARTICLES, self.search_particles // MODES)
        slipped = ParticleSet(PARTICLES, most, self.motion, self.random)
        slipped.set_gaussian(here.mean, slip_covariance())
        slipped.fuse(log_likelihood)
        found = slipped.estimate().mean
        if (
            is_elsewhere(found, here.mean)
            or is_same(found, here.mean)
            or any(is_same(found, one.pose) for one in self.others)
        ):
            return
        if not fits(found):
            return
        there, current = log_likelihood(np.array([found, here.mean]).T)
        slip = np.asarray(found) - np.asarray(here.mean)
        slip[2] = wrap(slip[2])
        size = float(slip @ np.linalg.solve(slip_covariance(), slip))
        odds = _SLIPPED - 0.5 * size + SEARCH_SHARE * float(there - current)
        if odds > _CARRIED:
            self._add(slipped.sample(PARTICLES, self.random), odds)

    def take_better(
        self,
        recent: RecentMeasurements,
        here: PoseEstimate,
        particles: ParticleSet,
        fit: ScanFit,
    ) -> Array | None:
        """Return the poses (3, n) of a hypothesis that is clearly likelier than the current pose.

        And likelier than all other positions together, unless the current pose is refuted;
        elsewhere the recent scans must fit as they usually did (`fit`): otherwise the robot may be
        where no search has looked. The current pose, with its `particles`, becomes a hypothesis in
        its place.
        """
        if not self.others:
            return None
        odds = self._odds(recent, here)
        best = int(np.argmax(odds))
        if odds[best] < _BETTER:
            return None
        if odds[best] < _REFUTED and self._share(odds, best) < _LIKELY:
            return None
        pose = self.others[best].particles.estimate()
        elsewhere = is_elsewhere(pose.mean, here.mean)
        if elsewhere and recent.scanned and not fit.as_usual(recent.fit(pose)):
            return None
        taken = self.others.pop(best)
        for one in self.others:
            one.odds -= taken.odds
        self._add(particles.sample(PARTICLES, self.random), -taken.odds)
        return taken.particles.sample(particles.least, self.random)

    def drop_near(self, recent: RecentMeasurements, here: PoseEstimate) -> None:
        """Drop hypotheses that have joined the current pose, or are as unlikely as any position."""
        self.others = [one for one in self.others if not is_same(one.pose, here.mean)]
        self._keep_likely(recent, here)

    def alternatives(self, recent: RecentMeasurements, here: PoseEstimate) -> list[Alternative]:
        """Return the other positions at which the robot may be, the most probable first."""
        if not self.others:
            return []
        weights = np.exp(np.minimum(self._odds(recent, here), 50.0))
        weights /= 1.0 + weights.sum()
        pairs = [
            Alternative(one.pose, float(weight))
            for one, weight in zip(self.others, weights, strict=True)
            if is_elsewhere(one.pose, here.mean)
        ]
        return sorted(pairs, key=lambda pair: -pair.probability)

    def _take_likely(self, recent: RecentMeasurements) -> Array | None:
        """Return the poses of the hypothesis that is likelier than all others, nine to one.

        Two searches must have found it, and the map must explain the scans there.
        """
        if not self.others:
            return None
        odds = self._odds(recent, None)
        best = int(np.argmax(odds))
        taken = self.others[best]
        if self._share(odds, best) < _LIKELY or taken.searches < 2:
            return None
        pose = taken.particles.estimate()
        if recent.fit(pose) < FITS and recent.support(pose).agreeing < 2:
            return None
        del self.others[best]
        for one in self.others:
            one.odds -= taken.odds
        return taken.particles.poses

    def _base(self, recent: RecentMeasurements, by_scans: Array) -> float:
        """Return what scans are worth at the likeliest hypothesis, or else at the best mode."""
        if not self.others:
            return float(by_scans.max())
        best = max(self.others, key=lambda one: one.odds)
        return float(recent.scan_worth(np.array([best.pose]).T)[0]) - best.odds

    def _odds(self, recent: RecentMeasurements, here: PoseEstimate | None) -> Array:
        """Return the log-odds (n,) of the hypotheses by scans and objects."""
        poses = np.array([one.pose for one in self.others]).T
        odds = np.array([one.odds for one in self.others]) + recent.object_worth(poses)
        if here is not None:
            odds -= recent.object_worth(np.array([here.mean]).T)[0]
        result: Array = odds
        return result

    def _share(self, odds: Array, best: int) -> float:
        """Return how probable one is against all elsewhere: nearby it is the same place."""
        pose = self.others[best].pose
        elsewhere = [is_elsewhere(one.pose, pose) for one in self.others]
        return 1.0 / (1.0 + float(np.exp(odds[elsewhere] - odds[best]).sum()))

    def _add(self, poses: Array, odds: float) -> None:
        particles = ParticleSet(PARTICLES, PARTICLES, self.motion, self.random)
        particles.set_particles(poses)
        self.others.append(Hypothesis(particles, odds))

    def _keep_likely(self, recent: RecentMeasurements, here: PoseEstimate | None) -> None:
        """Keep the likeliest hypotheses, without those that are as likely as any position."""
        if not self.others:
            return
        odds = self._odds(recent, here)
        least = odds.max() - _UNLIKELY if here is None else _CARRIED - math.log(recent.places)
        kept: list[Hypothesis] = []
        for k in np.argsort(-odds):
            one = self.others[k]
            if odds[k] <= least or len(kept) == _MOST:
                break
            if not any(is_same(one.pose, other.pose) for other in kept):
                kept.append(one)
        self.others = kept
