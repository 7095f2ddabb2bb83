"""Registers landmarks at their new positions, when observations from several poses agree on one.

Also compares and combines estimates of a position, and detects objects that seem to be at two
positions because two things look alike.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.map_builder.pose_reliability import (
    LEAST_SIMILARITY,
    MOST_SIMILARITY,
    REGISTRATION,
    update,
)
from cairn.planar.poses import apart
from cairn.visual_map.landmarks import (
    CANDIDATE_RELIABILITY,
    NO_VIEWPOINTS,
    CandidatePosition,
    ChangeKind,
    EvidenceVerdict,
    LandmarkChange,
    LandmarkEvidence,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
    PositionHistory,
)

Array = NDArray[np.float64]

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

# A landmark has not moved if its candidate is within this distance of its position [m], and within
# this normalized distance squared (2 degrees of freedom, 90 %).
_UNMOVED_M, _UNMOVED_NIS = 0.35, 4.6
# Observations from poses that differ by more than this [m], [rad] are independent: the same
# distances as in the localizer (`ANOTHER_M`).
INDEPENDENT_M, INDEPENDENT_RAD = 0.15, 0.2
# Density of observations of an object anywhere in view [1/m^2]: 4 m by 60 degrees.
CLUTTER = 1.0 / (0.5 * 4.0**2 * math.radians(60.0))
# The share of the robot's own error that all its observations of an hour have in common [m].
COMMON_ERROR = 0.15
# A landmark has returned to a former position if it is within this distance of it [m], as for one
# that has not moved.
_SAME_M = 0.35
# An object that people carry back and forth seldom returns twice within this time [s].
_REMEMBERED_S = 600.0
_MOST_DEPARTURES = 20  # positions that are remembered; twice the moves of a busy chair in that time
_RETURNS = 2
# Errors of two implied positions that no covariance states [m]: twice that of a surveyed position
# (`MAP_SIGMA` of the localizer, 0.03 m).
_ERROR_M = 0.06
# A candidate of at most this reliability, which no observation has confirmed (it starts at 0.1), is
# replaced by one that contradicts it.
_REPLACED = 0.15
# How long an object that seems to be at two positions is ignored [s].
_IGNORED_S = 600.0


def judge_candidate(
    landmark: LandmarkRecord, evidence: LandmarkEvidence, now_s: float
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    """Update the candidate position of a landmark without a valid one; register it if reliable.

    A position is registered when observations from different poses agree on it, unless the object
    alternates between positions.
    """
    if not evidence.healthy or evidence.verdict is EvidenceVerdict.NOT_CONVERGED:
        return landmark, None
    if is_ignored(landmark.history, now_s):
        return landmark, None
    seen = replace(landmark, evidence_count=landmark.evidence_count + 1)
    candidate = landmark.candidate
    fresh = CandidatePosition(evidence.implied, CANDIDATE_RELIABILITY, 1, evidence.robot)
    if candidate is None:
        return replace(seen, candidate=fresh), None
    if not apart(candidate.seen_from, evidence.robot, INDEPENDENT_M, INDEPENDENT_RAD):
        return landmark, None
    similarity = position_similarity(candidate.position, evidence.implied)
    if similarity < 0.5 and candidate.reliability <= _REPLACED:
        return replace(seen, candidate=fresh), None
    reliability = update(candidate.reliability, similarity)
    position = candidate.position
    if similarity >= 0.5:
        position = average(position, candidate.observations, evidence.implied)
    updated = CandidatePosition(position, reliability, candidate.observations + 1, evidence.robot)
    if reliability <= REGISTRATION:
        return replace(seen, candidate=updated), None
    history = record_arrival(landmark.history, position, now_s)
    if is_ignored(history, now_s):
        return _ignore(replace(seen, history=history))
    return _register(replace(seen, history=history), updated)


def record_departure(
    history: PositionHistory, position: MapPosition, now_s: float
) -> PositionHistory:
    """Record that a landmark was removed from a position."""
    kept = tuple((one, at) for one, at in history.departures if now_s - at <= _REMEMBERED_S)
    return replace(
        history,
        departures=(*kept, (position, now_s))[-_MOST_DEPARTURES:],
        returns=history.returns if kept else 0,
    )


def record_arrival(
    history: PositionHistory, position: MapPosition, now_s: float
) -> PositionHistory:
    """Record that a landmark is at a position; ignore it if it keeps returning to former ones."""
    has_returned = any(
        one.distance(position) <= _SAME_M and now_s - at <= _REMEMBERED_S
        for one, at in history.departures[:-1]
    )
    if not has_returned:
        return history
    if history.returns + 1 < _RETURNS:
        return replace(history, returns=history.returns + 1)
    return PositionHistory(ignored_until_s=now_s + _IGNORED_S)


def is_ignored(history: PositionHistory, now_s: float) -> bool:
    """Return whether a landmark is ignored because two things seem to look alike."""
    return now_s < history.ignored_until_s


def position_similarity(candidate: MapPosition, implied: MapPosition) -> float:
    """Return the odds that two positions are one, against clutter; in [0.1, 0.9]."""
    total = _summed_covariance(candidate, implied)
    nis = squared_distance(candidate, implied)
    density = math.exp(-0.5 * nis) / (2.0 * math.pi * math.sqrt(float(np.linalg.det(total))))
    similarity = density / (density + CLUTTER)
    return min(MOST_SIMILARITY, max(LEAST_SIMILARITY, similarity))


def squared_distance(one: MapPosition, other: MapPosition) -> float:
    """Return the squared Mahalanobis distance of two positions."""
    error = np.array([other.x - one.x, other.y - one.y])
    return float(error @ np.linalg.solve(_summed_covariance(one, other), error))


def fuse(position: MapPosition, implied: MapPosition) -> MapPosition:
    """Update a position by an implied one (Kalman), which shares the error of the robot's pose."""
    prior = _covariance(position)
    noise = _covariance(implied) + COMMON_ERROR**2 * np.eye(2)
    gain = prior @ np.linalg.inv(prior + noise)
    x, y = np.array([position.x, position.y]) + gain @ np.array(
        [implied.x - position.x, implied.y - position.y]
    )
    remaining = (np.eye(2) - gain) @ prior
    return MapPosition(
        float(x),
        float(y),
        float(remaining[0, 0]),
        float(0.5 * (remaining[0, 1] + remaining[1, 0])),
        float(remaining[1, 1]),
    )


def average(position: MapPosition, observations: int, implied: MapPosition) -> MapPosition:
    """Return the mean of a position from several `observations` and one more implied position.

    Observations of a few seconds share the errors of the robot's pose: they have equal weights, but
    together they are hardly more certain than one.
    """
    fused, share = fuse(position, implied), 1.0 / (observations + 1)
    x = position.x + share * (implied.x - position.x)
    y = position.y + share * (implied.y - position.y)
    return replace(fused, x=x, y=y)


def _ignore(landmark: LandmarkRecord) -> tuple[LandmarkRecord, LandmarkChange | None]:
    reason = (
        "it alternates between positions: two things look alike; it is ignored for ten minutes; "
        "remove one of them, or make them differ"
    )
    change = LandmarkChange(
        landmark.object_id,
        ChangeKind.REMOVED,
        landmark.position,
        None,
        CANDIDATE_RELIABILITY,
        reason,
    )
    return replace(landmark, candidate=None), change


def _register(
    landmark: LandmarkRecord, found: CandidatePosition
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    old = landmark.position
    unmoved = old is not None and _has_not_moved(old, found.position)
    position = old if unmoved and old is not None else found.position
    registered = replace(
        landmark,
        position=position,
        reliability=found.reliability,
        state=LandmarkState.LIVE,
        candidate=None,
        judged_from=found.seen_from,
        viewpoints=NO_VIEWPOINTS,
        missed_from=None,
        uncorroborated=0,
    )
    if unmoved and old is not None:
        kind = ChangeKind.RESTORED
        reason = f"seen again {old.distance(found.position):.2f} m from its position: not moved"
    else:
        kind = ChangeKind.REGISTERED
        reason = f"{found.observations} observations from different poses agree on the new position"
    return registered, LandmarkChange(
        landmark.object_id, kind, old, position, found.reliability, reason
    )


def _has_not_moved(old: MapPosition, found: MapPosition) -> bool:
    return old.distance(found) <= _UNMOVED_M and squared_distance(old, found) <= _UNMOVED_NIS


def _summed_covariance(one: MapPosition, other: MapPosition) -> Array:
    return _covariance(one) + _covariance(other) + _ERROR_M**2 * np.eye(2)


def _covariance(position: MapPosition) -> Array:
    return np.array([[position.xx, position.xy], [position.xy, position.yy]])
