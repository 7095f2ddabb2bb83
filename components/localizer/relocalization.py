"""Relocalization: what decides that the robot is lost, and when a search result is believed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.global_search import GlobalSearchResult, RecentMeasurements, search
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import PoseEstimate, carry, estimate
from cairn.components.localizer.pose_health import FITS
from cairn.components.localizer.recent_observations import TOGETHER_M, RecentObservations
from cairn.components.localizer.scan_fit import usual_fit
from cairn.planar.poses import Pose, apart, compose, distance, relative, wrap
from cairn.schemas.cairn_nav_msgs import Reason, ReasonCode

Array = NDArray[np.float64]

# Where no other reason is given, the constants of this module were chosen by hand;
# `lab/constants.yaml` has the effect of half and double. docs/benchmarks.md has the results
# for kidnapped robots.

# After the robot was found, the map is searched again for so long [s]: it may have been found in a
# wrong position that explains the few measurements so far. As long as observations are kept
# (`recent_observations`).
PROBATION_S = 30.0
# So many searches, from poses so far apart [m], must find it there again to confirm the position:
# static things do not become better evidence by being seen again from the same pose. Or no search
# may prefer another position for so long a distance [m].
_CONFIRMATIONS, _CONFIRM_EVERY_M, _UNDISPUTED_M = 3, 0.2, 1.0
# Objects may have been moved. Where they contradict a position, scans must decide alone: searches
# in a row from so many poses, so far apart [m], [rad], must find the robot there, unambiguously
# also without the objects, and the map must explain the scans beyond doubt (`_DOUBTFUL_FIT`).
_VIEWPOINTS, _ANOTHER_M, _ANOTHER_RAD = 3, 0.2, 0.35
# Another pose must explain the recent measurements better by this log-likelihood [nats]: errors
# that successive observations have in common are worth 2 to 4.
BETTER = 6.0
# If it is better by this [nats], the current pose is refuted: several times what common errors are
# worth.
REFUTED = 25.0
# The robot may be lost if scans fit the map less than the first share: search the map now and then.
# It is probably lost if they fit less than the second share, or less than the third share of their
# usual fit: search at once, and forget the earlier measurements.
_DOUBTFUL_FIT, _LOST_FIT, _LOST_OF_USUAL_FIT = 0.8, 0.5, 0.65
# Periods of the search [s]: in doubt; while a position is unconfirmed; if the robot is lost; and of
# a robot whose position is unknown.
_DOUBTFUL_EVERY_S, _UNCONFIRMED_EVERY_S, _LOST_EVERY_S, _UNKNOWN_EVERY_S = 3.0, 2.0, 1.0, 0.5
# For so long [s] a search that found the robot at its current position supports that position:
# until the next one in doubt.
_FOUND_HERE_S = 3.0
# From this share of the posterior on, a search result is unambiguous. With half of it as many of
# the robots on fr101 and fr079 are located (20 and 19 of 20, benchmark `localization_logs`).
_UNAMBIGUOUS = 0.9
# Without scans, a robot waits so long [s] for a second object before it believes a result by one
# object; or for the particles around the only object to narrow to this spread [m].
_WAIT_FOR_SECOND_S, _WAIT_FOR_SPREAD_S, _ONE_OBJECT_SPREAD_M = 15.0, 10.0, 0.8
_MOST_NATS = 100.0  # that no exponential function overflows
# A search result that is wider than this [m] is not one position.
_WIDEST_M = 0.5
# Poses that differ by less than this [m], [rad] are the same position; the modes of a search are as
# far apart.
_SAME_M, _SAME_RAD = 0.5, 0.35
_JUST_FOUND = Reason(
    ReasonCode.UNCONFIRMED, "the robot was found just now; other positions are not ruled out yet"
)


@dataclass(frozen=True)
class _Series:
    """Where scans alone have found the robot in all of the last searches.

    `pose` is that at the dead-reckoned pose `now`; from `viewpoints` of the poses, the last of
    them `seen_from`, each scan was another one.
    """

    pose: Pose
    now: Pose
    viewpoints: int
    seen_from: Pose


class Relocalizer:
    """Searches the map for the robot: at an unknown start, when it is probably lost, and for a
    while after it was found.
    """

    def __init__(self, search_particles: int, random: np.random.Generator) -> None:
        self.search_particles = search_particles
        self.random = random
        self._searched_at = -math.inf
        self._first_measured = math.inf
        self._modes: tuple[Array, Pose] | None = (
            None  # of the last search, and the dead-reckoned pose
        )
        self._guess: tuple[Pose, Pose] | None = None  # the last result, and the dead-reckoned pose
        self._series: _Series | None = None
        self._probation_ends = -math.inf
        self._confirmations = _CONFIRMATIONS
        self._confirmed_at: Pose = (0.0, 0.0, 0.0)  # dead-reckoned, as all poses here
        self._found_at: Pose = (0.0, 0.0, 0.0)
        self._away_m = 0.0
        self._fit = self._usual = 1.0
        self._here_at = -math.inf

    def accept(self) -> None:
        """Accept the robot's pose as known, as an operator stated it."""
        self._probation_ends = -math.inf
        self._confirmations = _CONFIRMATIONS
        self._fit = self._usual = 1.0
        self._guess = self._modes = self._series = None

    def confirmed(self, stamp: float) -> bool:
        """Whether no other position than the current one is likely any more."""
        return self.doubt(stamp) is None

    def doubt(self, stamp: float) -> Reason | None:
        """Return why the robot may be elsewhere; None if nothing indicates that."""
        if self._lost:
            return Reason(
                ReasonCode.SCAN_MISMATCH,
                f"scans fit the map by {self._fit:.0%}, usually by {self._usual:.0%}",
            )
        if self._confirmations >= _CONFIRMATIONS:
            return None
        undisputed = stamp >= self._probation_ends and self._away_m >= _UNDISPUTED_M
        return None if undisputed else _JUST_FOUND

    def found_here(self, stamp: float) -> bool:
        """Whether the last search, at most 3 s before `stamp` [s], clearly found the robot at
        its current position.
        """
        return self.confirmed(stamp) and stamp - self._here_at <= _FOUND_HERE_S

    def start_probation(self, stamp: float, now: Pose) -> None:
        """Search for the robot for a while, as at `stamp` [s] it was found where it may not be.

        `now` is the dead-reckoned pose.
        """
        self._probation_ends = stamp + PROBATION_S
        self._confirmations = 0
        self._confirmed_at = self._found_at = now
        self._away_m = 0.0
        self._fit = self._usual = 1.0

    def update_fit(self, fit: float) -> bool:
        """Update how well scans fit; return True when they start to indicate that the robot is
        lost.
        """
        before, self._fit = self._lost, fit
        self._usual = usual_fit(self._usual, fit)
        return self._lost and not before

    @property
    def _lost(self) -> bool:
        return self._fit < max(_LOST_FIT, _LOST_OF_USUAL_FIT * self._usual)

    def search_due(self, stamp: float, contradicted: bool) -> bool:
        """Whether to search at `stamp` [s]; `contradicted` by an object observed just now."""
        since = stamp - self._searched_at
        if contradicted or self._lost:
            return since >= _LOST_EVERY_S
        if not self.confirmed(stamp):
            return since >= _UNCONFIRMED_EVERY_S
        return self._fit < _DOUBTFUL_FIT and since >= _DOUBTFUL_EVERY_S

    def find(self, stamp: float, recent: RecentMeasurements) -> Array | None:
        """Return poses (3, n) of a robot whose position is unknown; None while it is ambiguous."""
        self._first_measured = min(self._first_measured, stamp)
        if stamp - self._searched_at < _UNKNOWN_EVERY_S:
            return None
        self._searched_at = stamp
        found = self._search(recent)
        series, self._series = self._series, None
        if found is None:
            self._guess = None
            return None
        if found.support.contradicting >= max(1, found.support.agreeing):
            self._guess = None
            return self._against_objects(stamp, recent, found, series)
        waited = stamp - self._first_measured
        firm = found.support.agreeing >= 2 or found.fit >= FITS
        if found.share >= _UNAMBIGUOUS and (
            firm or (waited >= _WAIT_FOR_SECOND_S and not recent.scanned)
        ):
            # Two modes take turns while there are few measurements: believe the one that stays.
            if self._found_again(found.pose.mean, recent.now):
                self.start_probation(stamp, recent.now)
                return found.poses
        elif (
            not recent.scanned
            and waited >= _WAIT_FOR_SPREAD_S
            and estimate(found.everywhere, np.zeros(found.everywhere.shape[1])).spread
            < _ONE_OBJECT_SPREAD_M
        ):
            # One object alone leaves an arc around it open; its width is published, and the filter
            # narrows it sooner than waiting does.
            self.start_probation(stamp, recent.now)
            return found.everywhere
        return None

    def recover(self, stamp: float, recent: RecentMeasurements, here: PoseEstimate) -> Array | None:
        """Return poses (3, n) of a robot whose pose is `here`, if it is clearly elsewhere."""
        self._searched_at = stamp
        self._away_m = max(self._away_m, distance(recent.now, self._found_at))
        found = self._search(recent)
        series, self._series = self._series, None
        if found is None or found.pose.spread > _WIDEST_M:
            self._confirmations = 0
            return None
        if _same(here.mean, found.pose.mean):
            clearly = found.share >= _UNAMBIGUOUS
            self._here_at = stamp if clearly else -math.inf
            self._confirm(clearly, recent.now)
            return None
        self._here_at = -math.inf
        self._confirmations = 0
        score = recent.log_likelihood(np.asarray(here.mean)[:, None])
        if found.score - float(score[0]) < BETTER:
            return None
        # As long as another position explains more, time does not confirm this one.
        self._probation_ends = stamp + PROBATION_S
        support = found.support
        # If the robot is certainly not here, the search continues better from the likeliest
        # position.
        refuted = found.score - float(score[0]) >= REFUTED and found.fit >= FITS
        if support.contradicting > support.agreeing:
            return self._against_objects(stamp, recent, found, series, here)
        if found.share < _UNAMBIGUOUS and not refuted:
            return None
        fits = recent.scanned and found.fit >= max(FITS, recent.fit(here))
        if not fits and support.agreeing < 2:
            return None
        # Positions that look alike take turns while there are few measurements: believe the one
        # that stays.
        again = self._found_again(found.pose.mean, recent.now)
        if not again and support.agreeing < 2:
            return None
        self.start_probation(stamp, recent.now)
        return found.poses

    def _confirm(self, clearly: bool, now: Pose) -> None:
        """Note that a search found the robot at its current position, `clearly` or not."""
        if not clearly:
            self._confirmations = 0
        elif distance(now, self._confirmed_at) >= _CONFIRM_EVERY_M:
            self._confirmations += 1
            self._confirmed_at = now

    def _against_objects(
        self,
        stamp: float,
        recent: RecentMeasurements,
        found: GlobalSearchResult,
        series: _Series | None,
        here: PoseEstimate | None = None,
    ) -> Array | None:
        """Return the poses (3, n) of a search that objects contradict, once scans decide alone.

        `series`: of the searches before; `here`: the robot's pose, if it has one.
        """
        if not recent.scanned or found.fit < _DOUBTFUL_FIT or found.modes is None:
            return None
        pose, now = found.pose.mean, recent.now
        alone = replace(recent, observations=RecentObservations())
        score = float(alone.log_likelihood(np.asarray(pose)[:, None])[0])
        if here is not None:
            ahead = score - float(alone.log_likelihood(np.asarray(here.mean)[:, None])[0])
            if ahead < BETTER:
                return None
        elsewhere = found.modes[:, [not _same(pose, (x, y, t)) for x, y, t in found.modes.T]]
        better_by = np.minimum(alone.log_likelihood(elsewhere) - score, _MOST_NATS)
        if 1.0 / (1.0 + float(np.exp(better_by).sum())) < _UNAMBIGUOUS:
            return None
        if series is None or not _same(compose(series.pose, relative(series.now, now)), pose):
            series = _Series(pose, now, 1, now)
        elif apart(series.seen_from, now, _ANOTHER_M, _ANOTHER_RAD):
            series = _Series(pose, now, series.viewpoints + 1, now)
        else:
            series = replace(series, pose=pose, now=now)
        if series.viewpoints < _VIEWPOINTS:
            self._series = series
            return None
        self.start_probation(stamp, now)
        return found.poses

    def _found_again(self, pose: Pose, now: Pose) -> bool:
        """Whether the last search found the robot at the same position, carried on by odometry."""
        guess, self._guess = self._guess, (pose, now)
        return guess is not None and _same(compose(guess[0], relative(guess[1], now)), pose)

    def _search(self, recent: RecentMeasurements) -> GlobalSearchResult | None:
        known = None
        if self._modes is not None:
            modes, then = self._modes
            known = carry(modes, relative(then, recent.now))
        found = search(recent, self.search_particles, self.random, known)
        if found is None or found.modes is None:
            self._modes = None
        else:
            self._modes = (found.modes, recent.now)
        return found


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


def _same(a: Pose, b: Pose) -> bool:
    return distance(a, b) < _SAME_M and abs(wrap(a[2] - b[2])) < _SAME_RAD
