"""The objects of the visual map, and what one piece of evidence does to one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from components.map_builder.reliability import INITIAL, REGISTRATION, REMOVAL, update
from planar.poses import Pose, apart

Array = NDArray[np.float64]

# Density [1/m^2] of a sighting of an object that stands anywhere in view: 4 m by 60 degrees.
CLUTTER = 1.0 / (0.5 * 4.0**2 * math.radians(60.0))
# A sighting's share of the robot's own error, which all its sightings of an hour have in common.
COMMON_ERROR = 0.15  # [m]
# A candidate no farther than this from where the object stood has not moved.
UNMOVED = 0.35  # [m]
# From poses that differ by more than this [m], [rad] sightings are independent.
ANOTHER_M, ANOTHER_RAD = 0.15, 0.2
# A candidate begins with the reliability that its old place had when it was removed.
CARRIED_OVER = 0.1


class State(IntEnum):
    """As the constants of cairn_msgs/VisualObject."""

    LIVE = 0
    RELOCATING = 1


class Kind(IntEnum):
    """As the constants of cairn_msgs/VisualMapChange."""

    IMPORTED = 0
    REMOVED = 1
    REGISTERED = 2
    REFINED = 3
    RESTORED = 4


class Verdict(IntEnum):
    """As the constants of cairn_msgs/ObjectEvidence."""

    AGREES = 0
    DISAGREES = 1
    FALSE_MATCH = 2
    NOT_CONVERGED = 3


@dataclass(frozen=True)
class Place:
    """A place in the map [m] and its covariance [m^2]."""

    x: float
    y: float
    xx: float
    xy: float
    yy: float

    def distance(self, other: Place) -> float:
        """Metres between two places."""
        return math.hypot(self.x - other.x, self.y - other.y)


@dataclass(frozen=True)
class Candidate:
    """A place that a removed object may have moved to."""

    place: Place
    reliability: float
    sightings: int
    seen_from: Pose


@dataclass(frozen=True)
class MapObject:
    """One object: `place` is None until it was ever registered."""

    object_id: int
    name: str
    place: Place | None
    reliability: float = INITIAL
    state: State = State.LIVE
    evidence_count: int = 0
    candidate: Candidate | None = None
    judged_from: Pose | None = None


@dataclass(frozen=True)
class Evidence:
    """What one sighting says of one object, and the robot's pose when it was made."""

    object_id: int
    similarity: float
    verdict: Verdict
    distance: float
    implied: Place
    robot: Pose
    healthy: bool


@dataclass(frozen=True)
class Change:
    """A change of the map: kind, places before and after, reliability, the reason in words."""

    object_id: int
    kind: Kind
    old: Place | None
    new: Place | None
    reliability: float
    reason: str


def judge(known: MapObject, evidence: Evidence) -> tuple[MapObject, Change | None]:
    """What `evidence` makes of an object: the new object and the change of the map, if any."""
    if known.state is State.LIVE:
        return _judge_live(known, evidence)
    return _judge_candidate(known, evidence)


def unknown(object_id: int) -> MapObject:
    """An object that the map does not hold: it has yet to be placed."""
    return MapObject(
        object_id, f"object {object_id}", None, reliability=CARRIED_OVER, state=State.RELOCATING
    )


def _judge_live(known: MapObject, evidence: Evidence) -> tuple[MapObject, Change | None]:
    if evidence.verdict not in (Verdict.AGREES, Verdict.DISAGREES) or evidence.similarity == 0.5:
        return known, None
    # Sightings from one pose share their error: the first one counts.
    if known.judged_from is not None and not apart(
        known.judged_from, evidence.robot, ANOTHER_M, ANOTHER_RAD
    ):
        return known, None
    reliability = update(known.reliability, evidence.similarity)
    judged = replace(
        known,
        reliability=reliability,
        evidence_count=known.evidence_count + 1,
        judged_from=evidence.robot,
    )
    if reliability <= REMOVAL:
        start = Candidate(evidence.implied, CARRIED_OVER, 1, evidence.robot)
        removed = replace(judged, state=State.RELOCATING, candidate=start)
        away_m = known.place.distance(evidence.implied) if known.place else math.nan
        reason = (
            f"reliability fell to {reliability:.2f}; the last sighting implies a place "
            f"{away_m:.2f} m away (distance of equation 1: {evidence.distance:.2f})"
        )
        return removed, Change(
            known.object_id, Kind.REMOVED, known.place, None, reliability, reason
        )
    if evidence.verdict is Verdict.AGREES and evidence.healthy and known.place is not None:
        return _refine(judged, known.place, evidence)
    return judged, None


def _refine(judged: MapObject, place: Place, evidence: Evidence) -> tuple[MapObject, Change | None]:
    """Bring a place that is still uncertain nearer the truth; a surveyed one hardly moves."""
    better = fuse(place, evidence.implied)
    refined = replace(judged, place=better)
    if place.distance(better) < 0.01:
        return refined, None
    reason = f"agreeing sighting from another pose moved it by {place.distance(better):.3f} m"
    return refined, Change(
        judged.object_id, Kind.REFINED, place, better, judged.reliability, reason
    )


def _judge_candidate(known: MapObject, evidence: Evidence) -> tuple[MapObject, Change | None]:
    if not evidence.healthy or evidence.verdict is Verdict.NOT_CONVERGED:
        return known, None
    seen = replace(known, evidence_count=known.evidence_count + 1)
    candidate = known.candidate
    fresh = Candidate(evidence.implied, CARRIED_OVER, 1, evidence.robot)
    if candidate is None:
        return replace(seen, candidate=fresh), None
    if not apart(candidate.seen_from, evidence.robot, ANOTHER_M, ANOTHER_RAD):
        return known, None
    similarity = place_similarity(candidate.place, evidence.implied)
    if similarity < 0.5 and candidate.reliability <= 0.15:
        return replace(seen, candidate=fresh), None
    reliability = update(candidate.reliability, similarity)
    place = fuse(candidate.place, evidence.implied) if similarity >= 0.5 else candidate.place
    moved = Candidate(place, reliability, candidate.sightings + 1, evidence.robot)
    if reliability <= REGISTRATION:
        return replace(seen, candidate=moved), None
    return _register(seen, moved)


def _register(known: MapObject, found: Candidate) -> tuple[MapObject, Change | None]:
    old = known.place
    unmoved = old is not None and old.distance(found.place) <= UNMOVED
    place = old if unmoved and old is not None else found.place
    registered = replace(
        known,
        place=place,
        reliability=found.reliability,
        state=State.LIVE,
        candidate=None,
        judged_from=found.seen_from,
    )
    if unmoved and old is not None:
        kind = Kind.RESTORED
        reason = f"seen again {old.distance(found.place):.2f} m from its place: it had not moved"
    else:
        kind = Kind.REGISTERED
        reason = f"{found.sightings} sightings from different poses agree on the new place"
    return registered, Change(known.object_id, kind, old, place, found.reliability, reason)


def place_similarity(candidate: Place, implied: Place) -> float:
    """Odds that two implied places are one, against a sighting anywhere in view; in [0.1, 0.9]."""
    total = _covariance(candidate) + _covariance(implied) + 0.06**2 * np.eye(2)
    error = np.array([implied.x - candidate.x, implied.y - candidate.y])
    nis = float(error @ np.linalg.solve(total, error))
    density = math.exp(-0.5 * nis) / (2.0 * math.pi * math.sqrt(float(np.linalg.det(total))))
    return min(0.9, max(0.1, density / (density + CLUTTER)))


def fuse(place: Place, implied: Place) -> Place:
    """Kalman update of a place by an implied place, whose error the robot's pose has part in."""
    prior = _covariance(place)
    noise = _covariance(implied) + COMMON_ERROR**2 * np.eye(2)
    gain = prior @ np.linalg.inv(prior + noise)
    x, y = np.array([place.x, place.y]) + gain @ np.array(
        [implied.x - place.x, implied.y - place.y]
    )
    left = (np.eye(2) - gain) @ prior
    return Place(
        float(x),
        float(y),
        float(left[0, 0]),
        float(0.5 * (left[0, 1] + left[1, 0])),
        float(left[1, 1]),
    )


def _covariance(place: Place) -> Array:
    return np.array([[place.xx, place.xy], [place.xy, place.yy]])
