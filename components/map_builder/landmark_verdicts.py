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
from cairn.components.map_builder.viewpoints import (
    add_absence,
    add_recognition,
    cell_of,
    similarity_of_absence,
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
