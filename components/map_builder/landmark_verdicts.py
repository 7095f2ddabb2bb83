"""Decides by evidence whether a landmark still stands, has moved, or is gone.

`judge` is the rule that keeps a robot's map. An observation that disagrees, or a landmark that is
not seen from where it used to be seen, lowers the reliability; at `pose_reliability.REMOVAL` the
landmark is removed from its position. `landmark_registration.py` then finds its new one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from cairn.components.map_builder.landmark_registration import (
    INDEPENDENT_M,
    INDEPENDENT_RAD,
    fuse,
    judge_candidate,
    record_departure,
)
from cairn.components.map_builder.pose_reliability import REMOVAL, update
from cairn.planar.poses import Pose, apart
from cairn.visual_map.landmarks import (
    CANDIDATE_RELIABILITY,
    NO_VIEWPOINTS,
    CandidatePosition,
    Cell,
    ChangeKind,
    EvidenceVerdict,
    LandmarkChange,
    LandmarkEvidence,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
    Viewpoints,
)

Rule = Callable[
    [LandmarkRecord, LandmarkEvidence, float], tuple[LandmarkRecord, LandmarkChange | None]
]
"""A function of a landmark, evidence and its time [s]: the new record and the change, if any."""

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

# Absences from poses that differ by more than this [m], [rad] are independent: more than for
# observations, as what hides a landmark is as large as a person.
_ABSENCE_M, _ABSENCE_RAD = 0.4, 0.5
# A cell of viewpoints: directions from the landmark to the robot, and bands of distance [m].
_SECTORS = 12
_BAND_M = 1.0
_MOST_BAND = 30  # the last band is endless: no camera recognizes a landmark from so far
# Counts are halved beyond this, so that recent ones outweigh old ones.
_MOST_COUNTS = 64
# A landmark that was recognized less often than this from a cell is not expected to be again.
_KNOWN_FROM = 3
# Probability of recognizing a landmark that is not there; benchmark `recognition` found none in 150
# pictures.
_FALSE_POSITIVE = 0.02
# Least similarity of a single absence: what hides a landmark now hides it a moment later, too.
_LEAST_SIMILARITY = 0.3
# A refined position that moved less than this [m] is not a change that is published.
_REFINED_M = 0.01


def judge(
    landmark: LandmarkRecord, evidence: LandmarkEvidence, now_s: float
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    """Apply the rule that keeps a robot's map."""
    if evidence.verdict is EvidenceVerdict.UNSEEN:
        return _judge_absence(landmark, evidence)
    if landmark.state is LandmarkState.LIVE:
        return _judge_observation(landmark, evidence, now_s)
    return judge_candidate(landmark, evidence, now_s)


def add_recognition(viewpoints: Viewpoints, cell: Cell) -> Viewpoints:
    """Count a recognition from a cell; absences since the last one were misses."""
    missed = dict(viewpoints.missed)
    for one in viewpoints.absent:
        missed[one] = missed.get(one, 0) + 1
    seen = dict(viewpoints.seen)
    seen[cell] = seen.get(cell, 0) + 1
    if seen[cell] > _MOST_COUNTS:
        seen[cell] //= 2
        missed[cell] = missed.get(cell, 0) // 2
    return Viewpoints(tuple(sorted(seen.items())), tuple(sorted(missed.items())))


def add_absence(viewpoints: Viewpoints, cell: Cell) -> Viewpoints:
    """Record that the landmark was not recognized from a cell."""
    return replace(viewpoints, absent=(*viewpoints.absent, cell))


def similarity_of_absence(viewpoints: Viewpoints, cell: Cell) -> float | None:
    """Return the similarity of not being recognized from a cell, in [0, 0.5].

    It is the probability of missing a present landmark against that of not "recognizing" an absent
    one. None if the landmark is not known to be recognized from there.
    """
    seen = dict(viewpoints.seen).get(cell, 0)
    if seen < _KNOWN_FROM:
        return None
    missing = 1.0 - seen / (seen + dict(viewpoints.missed).get(cell, 0) + 1.0)
    return max(_LEAST_SIMILARITY, missing / (missing + 1.0 - _FALSE_POSITIVE))


def cell_of(x: float, y: float, robot: Pose) -> Cell:
    """Return the cell in which the robot sees a landmark at x, y [m]."""
    dx, dy = robot[0] - x, robot[1] - y
    sector = math.floor((math.atan2(dy, dx) + math.pi) / (2.0 * math.pi) * _SECTORS)
    band = min(math.hypot(dx, dy) / _BAND_M, _MOST_BAND)
    return min(sector, _SECTORS - 1), math.floor(band)


def _judge_observation(
    landmark: LandmarkRecord, evidence: LandmarkEvidence, now_s: float
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    agrees = evidence.verdict is EvidenceVerdict.AGREES
    disagrees = evidence.verdict is EvidenceVerdict.DISAGREES
    if not (agrees or disagrees) or evidence.similarity == 0.5:
        return landmark, None
    # Observations from one pose share their error: only the first one counts.
    if landmark.judged_from is not None and not apart(
        landmark.judged_from, evidence.robot, INDEPENDENT_M, INDEPENDENT_RAD
    ):
        return landmark, None
    alone = evidence.stands_alone
    reliability = update(landmark.reliability, evidence.effective_similarity)
    if disagrees and not alone:
        # This corroborates the earlier disagreements: each of them now counts as this one does.
        for _ in range(landmark.uncorroborated):
            reliability = update(reliability, evidence.similarity)
    judged = replace(
        landmark,
        reliability=reliability,
        evidence_count=landmark.evidence_count + 1,
        judged_from=evidence.robot,
        uncorroborated=landmark.uncorroborated + 1 if alone else 0,
    )
    position = landmark.position
    if agrees and evidence.healthy and position is not None:
        here = cell_of(position.x, position.y, evidence.robot)
        viewpoints = add_recognition(landmark.viewpoints, here)
        judged = replace(judged, viewpoints=viewpoints, missed_from=None)
    if reliability <= REMOVAL:
        return _remove_moved(judged, evidence, now_s)
    if agrees and evidence.healthy and position is not None:
        return _refine(judged, position, evidence)
    return judged, None


def _remove_moved(
    judged: LandmarkRecord, evidence: LandmarkEvidence, now_s: float
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    """Remove a landmark from its position; the last observation is the first candidate."""
    position, reliability = judged.position, judged.reliability
    start = CandidatePosition(evidence.implied, CANDIDATE_RELIABILITY, 1, evidence.robot)
    history = record_departure(judged.history, position, now_s) if position else judged.history
    removed = replace(judged, state=LandmarkState.RELOCATING, candidate=start, history=history)
    away_m = position.distance(evidence.implied) if position else math.nan
    reason = (
        f"reliability fell to {reliability:.2f}; the last observation implies a position "
        f"{away_m:.2f} m away (distance of equation 1: {evidence.distance:.2f})"
    )
    return removed, LandmarkChange(
        judged.object_id, ChangeKind.REMOVED, position, None, reliability, reason
    )


def _judge_absence(
    landmark: LandmarkRecord, evidence: LandmarkEvidence
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    """Judge that a landmark was not seen where it should have been.

    It counts only from where the landmark is known to be recognized, and only after the robot has
    moved: what hides the landmark now hides it in the next image, too.
    """
    position = landmark.position
    if landmark.state is not LandmarkState.LIVE or not evidence.healthy or position is None:
        return landmark, None
    if landmark.missed_from is not None and not apart(
        landmark.missed_from, evidence.robot, _ABSENCE_M, _ABSENCE_RAD
    ):
        return landmark, None
    here = cell_of(position.x, position.y, evidence.robot)
    similarity = similarity_of_absence(landmark.viewpoints, here)
    if similarity is None:
        return landmark, None
    reliability = update(landmark.reliability, similarity)
    viewpoints = add_absence(landmark.viewpoints, here)
    missed = replace(
        landmark,
        reliability=reliability,
        evidence_count=landmark.evidence_count + 1,
        viewpoints=viewpoints,
        missed_from=evidence.robot,
        judged_from=None,  # the next observation is new evidence, from any pose
    )
    if reliability > REMOVAL:
        return missed, None
    reason = (
        f"reliability fell to {reliability:.2f}: it was not seen from the last "
        f"{len(viewpoints.absent)} of the viewpoints from which it used to be seen"
    )
    removed = replace(
        missed, state=LandmarkState.RELOCATING, candidate=None, viewpoints=NO_VIEWPOINTS
    )
    return removed, LandmarkChange(
        landmark.object_id, ChangeKind.REMOVED, position, None, reliability, reason
    )


def _refine(
    judged: LandmarkRecord, position: MapPosition, evidence: LandmarkEvidence
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    """Improve an uncertain position by an agreeing observation; surveyed ones hardly move."""
    better = fuse(position, evidence.implied)
    refined = replace(judged, position=better)
    moved_m = position.distance(better)
    if moved_m < _REFINED_M:
        return refined, None
    reason = f"agreeing observation from another pose moved it by {moved_m:.3f} m"
    return refined, LandmarkChange(
        judged.object_id, ChangeKind.REFINED, position, better, judged.reliability, reason
    )
