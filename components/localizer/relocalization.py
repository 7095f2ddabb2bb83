"""Relocalization: when the map is searched for a lost robot, and when a result is believed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.global_search import GlobalSearchResult, RecentMeasurements, search
from cairn.components.localizer.health import FITS
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import PoseEstimate, carry, estimate
from cairn.components.localizer.recent_observations import TOGETHER
from cairn.planar.poses import Pose, compose, distance, relative, wrap
from cairn.schemas.cairn_nav_msgs import ReasonCode

Array = NDArray[np.float64]


class ConfirmationHistory:
    """When each mapped object was last seen where a pose that did not rely on it expected it.

    Somewhere else one object may stand as expected by chance, two at different places hardly do.
    """

    def __init__(self) -> None:
        self._at: dict[int, float] = {}
        self.confirmed_until = -math.inf
        """Until when [s] the robot was certainly not lost before it was placed anew."""

    def note(self, stamp: float, objects: Iterable[int]) -> None:
        """Take which objects agreed at `stamp` [s]."""
        self._at |= dict.fromkeys(objects, stamp)

    def placed_anew(self, landmarks: Mapping[int, Landmark]) -> None:
        """Take that the robot may be somewhere else than what has agreed so far made believe."""
        self.confirmed_until = max(self.confirmed_until, self._both_since(landmarks))
        self._at.clear()

    def _both_since(self, landmarks: Mapping[int, Landmark]) -> float:
        """The latest time [s] since when objects at two places agreed; -inf if none did."""
        newest: Landmark | None = None
        for object_id, stamp in sorted(self._at.items(), key=lambda one: -one[1]):
            mark = landmarks.get(object_id)
            if mark is None:
                continue
            if newest is None:
                newest = mark
            elif math.hypot(mark.x - newest.x, mark.y - newest.y) > TOGETHER:
                return stamp
        return -math.inf


# A robot that was found is looked for anew this long [s]: it may have been found in a wrong place
# that explains what little was seen.
PROBATION_S = 30.0
# So many looks, from poses so far apart [m], must find it there again before that place is sure:
# what a robot sees that stands does not get truer by being seen again. Or nothing may speak against
# it on so long a way [m].
_CONFIRMATIONS, _CONFIRMED_AFTER_M, _UNDISPUTED_M = 3, 0.2, 1.0
# By so much [nats] another pose must explain the recent observations better: errors that successive
# observations have in common are worth 2 to 4.
BETTER = 6.0
# By so much [nats], and the other pose is refuted.
REFUTED = 25.0
# Scans that fit less than this are a reason to look elsewhere now and then; less than that, or
# than this share of what they usually do, to do so at once and to forget what was seen before.
_WARY, _SUSPICIOUS, _OF_USUAL = 0.8, 0.5, 0.65
# Share of the newest scan in how well they usually fit; of one that fits much worse, less: a
# carried robot is not to get used to its wrong place.
_NEWEST, _NEWEST_OF_BAD = 0.02, 0.001
# How often to look [s].
_WARY_EVERY_S, _EVERY_S = 3.0, 1.0
# For so long [s] a search that found the robot where it is believed to be speaks for that place.
_HERE_S = 3.0
_UNCONFIRMED = (
    ReasonCode.UNCONFIRMED,
    "the robot was found just now; other positions are not ruled out yet",
)


class Relocalizer:
    """Looks for the robot: at an unknown start, when it is suspected to be lost, and for a while
    after it was found.
    """

    def __init__(self, search_particles: int, random: np.random.Generator) -> None:
        self.search_particles = search_particles
        self.random = random
        self._searched_at = -math.inf
        self._first_seen = math.inf
        self._places: tuple[Array, Pose] | None = None  # those of the last look, as the guess
        self._guess: tuple[Pose, Pose] | None = None  # and the dead-reckoned pose of that time
        self._probation_ends = -math.inf
        self._confirmations = _CONFIRMATIONS
        self._confirmed_at: Pose = (0.0, 0.0, 0.0)  # dead-reckoned, as all poses here
        self._found_at: Pose = (0.0, 0.0, 0.0)
        self._away_m = 0.0
        self._fit = self._usual = 1.0
        self._here_at = -math.inf

    def believe(self) -> None:
        """Take the robot's place as known."""
        self._probation_ends = -math.inf
        self._confirmations = _CONFIRMATIONS
        self._fit = self._usual = 1.0
        self._guess = self._places = None

    def sure(self, stamp: float) -> bool:
        """Whether no other place than where the robot was found is likely any more."""
        return not self.doubts(stamp)

    def doubts(self, stamp: float) -> tuple[ReasonCode, str] | None:
        """Return why the robot may be elsewhere, as code and in words; None if it is not likely."""
        if self._suspicious:
            return (
                ReasonCode.SCAN_MISMATCH,
                f"scans fit the map by {self._fit:.0%}, usually by {self._usual:.0%}",
            )
        if self._confirmations >= _CONFIRMATIONS:
            return None
        undisputed = stamp >= self._probation_ends and self._away_m >= _UNDISPUTED_M
        return None if undisputed else _UNCONFIRMED

    def found_here(self, stamp: float) -> bool:
        """Whether the last search, no longer ago than 3 s, found the robot where it is believed
        to be, and clearly; `stamp` [s] is now.
        """
        return self.sure(stamp) and stamp - self._here_at <= _HERE_S

    def doubt(self, stamp: float, now: Pose) -> None:
        """Look for the robot for a while, as at `stamp` [s] it was found where it may not be.

        `now` is the dead-reckoned pose.
        """
        self._probation_ends = stamp + PROBATION_S
        self._confirmations = 0
        self._confirmed_at = self._found_at = now
        self._away_m = 0.0
        self._fit = self._usual = 1.0

    def suspects(self, fit: float) -> bool:
        """Take how well scans fit of late; True when the robot seems to be somewhere else now."""
        before, self._fit = self._suspicious, fit
        newest = _NEWEST if fit >= 0.8 * self._usual else _NEWEST_OF_BAD
        self._usual += newest * (fit - self._usual)
        return self._suspicious and not before

    @property
    def _suspicious(self) -> bool:
        return self._fit < max(_SUSPICIOUS, _OF_USUAL * self._usual)

    def due(self, stamp: float, contradicted: bool) -> bool:
        """Whether to search at `stamp` [s]; `contradicted` by an object seen just now."""
        since = stamp - self._searched_at
        if contradicted or self._suspicious:
            return since >= _EVERY_S
        if not self.sure(stamp):
            return since >= 2.0 * _EVERY_S
        return self._fit < _WARY and since >= _WARY_EVERY_S

    def find(self, stamp: float, evidence: RecentMeasurements) -> Array | None:
        """Poses (3, n) of a robot whose place is not known; None as long as it is in doubt."""
        self._first_seen = min(self._first_seen, stamp)
        if stamp - self._searched_at < 0.5:
            return None
        self._searched_at = stamp
        found = self._search(evidence)
        if found is None or found.support.contradicting >= max(1, found.support.agreeing):
            self._guess = None
            return None
        waited = stamp - self._first_seen
        firm = found.support.agreeing >= 2 or found.fit >= FITS
        if found.share >= 0.9 and (firm or (waited >= 15.0 and not evidence.scanned)):
            # Two modes take turns while little was seen: believe the one that stays.
            if self._again(found.pose.mean, evidence.now):
                self.doubt(stamp, evidence.now)
                return found.poses
        elif (
            not evidence.scanned
            and waited >= 10.0
            and estimate(found.everywhere, np.zeros(found.everywhere.shape[1])).spread < 0.8
        ):
            # One place alone leaves an arc around it open; its width is stated, and the filter
            # narrows it sooner than waiting does.
            self.doubt(stamp, evidence.now)
            return found.everywhere
        return None

    def recover(
        self, stamp: float, evidence: RecentMeasurements, here: PoseEstimate
    ) -> Array | None:
        """Poses (3, n) of a robot believed to be `here`, if it is clearly somewhere else."""
        self._searched_at = stamp
        self._away_m = max(self._away_m, distance(evidence.now, self._found_at))
        found = self._search(evidence)
        if found is None or found.pose.spread > 0.5:
            self._confirmations = 0
            return None
        if _close(here.mean, found.pose.mean):
            clearly = found.share >= 0.9
            self._here_at = stamp if clearly else -math.inf
            self._confirm(clearly, evidence.now)
            return None
        self._here_at = -math.inf
        self._confirmations = 0
        score = evidence.log_likelihood(np.asarray(here.mean)[:, None])
        if found.score - float(score[0]) < BETTER:
            return None
        # As long as another place explains more, time does not make this one sure.
        self._probation_ends = stamp + PROBATION_S
        support = found.support
        # A robot that is certainly not here had better look on from the likeliest place.
        refuted = found.score - float(score[0]) >= REFUTED and found.fit >= FITS
        if (found.share < 0.9 and not refuted) or support.contradicting > support.agreeing:
            return None
        fits = evidence.scanned and found.fit >= max(FITS, evidence.fit(here))
        if not fits and support.agreeing < 2:
            return None
        # Places that look alike take turns, as long as little was seen: believe the one that stays.
        again = self._again(found.pose.mean, evidence.now)
        if not again and support.agreeing < 2:
            return None
        self.doubt(stamp, evidence.now)
        return found.poses

    def _confirm(self, clearly: bool, now: Pose) -> None:
        """Note that a look found the robot where it is believed to be."""
        if not clearly:
            self._confirmations = 0
        elif distance(now, self._confirmed_at) >= _CONFIRMED_AFTER_M:
            self._confirmations += 1
            self._confirmed_at = now

    def _again(self, pose: Pose, now: Pose) -> bool:
        """Whether the last look found the robot where it is found now, carried on by odometry."""
        guess, self._guess = self._guess, (pose, now)
        return guess is not None and _close(compose(guess[0], relative(guess[1], now)), pose)

    def _search(self, evidence: RecentMeasurements) -> GlobalSearchResult | None:
        known = None
        if self._places is not None:
            places, then = self._places
            known = carry(places, relative(then, evidence.now))
        found = search(evidence, self.search_particles, self.random, known)
        if found is None or found.places is None:
            self._places = None
        else:
            self._places = (found.places, evidence.now)
        return found


def _close(a: Pose, b: Pose) -> bool:
    return distance(a, b) < 0.5 and abs(wrap(a[2] - b[2])) < 0.35
