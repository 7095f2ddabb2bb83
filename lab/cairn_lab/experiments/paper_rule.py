"""The paper's literal rule, for comparison: equation (2) without limits, all observations count."""

from __future__ import annotations

from dataclasses import replace

from cairn.visual_map.landmarks import (
    INITIAL_RELIABILITY,
    CandidatePosition,
    ChangeKind,
    EvidenceVerdict,
    LandmarkChange,
    LandmarkEvidence,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
)

_REMOVAL = 0.1  # a landmark of less reliability is deleted (section 3.2)


def judge_by_paper(
    landmark: LandmarkRecord, evidence: LandmarkEvidence, now_s: float
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    """Apply section 3.2 of the paper literally, whatever the time."""
    del now_s
    if evidence.verdict in (EvidenceVerdict.UNSEEN, EvidenceVerdict.NOT_CONVERGED):
        return landmark, None
    seen = replace(landmark, evidence_count=landmark.evidence_count + 1)
    if landmark.state is LandmarkState.LIVE:
        reliability = equation_2(landmark.reliability, evidence.effective_similarity)
        if reliability >= _REMOVAL:
            return replace(seen, reliability=reliability), None
        # New samples are drawn around the position that this observation implies, and their
        # reliability starts again.
        candidate = CandidatePosition(evidence.implied, INITIAL_RELIABILITY, 1, evidence.robot)
        reason = f"reliability fell to {reliability:.3g}"
        change = LandmarkChange(
            landmark.object_id, ChangeKind.REMOVED, landmark.position, None, reliability, reason
        )
        removed = replace(
            seen, reliability=reliability, state=LandmarkState.RELOCATING, candidate=candidate
        )
        return removed, change
    return _register(seen, evidence.implied, evidence)


def _register(
    landmark: LandmarkRecord, position: MapPosition, evidence: LandmarkEvidence
) -> tuple[LandmarkRecord, LandmarkChange | None]:
    """Register a landmark where this observation places it.

    The samples that are drawn around it are those of the robot, so their similarity is 1 and the
    reliability rises above 0.5 at once.
    """
    reliability = equation_2(INITIAL_RELIABILITY, 1.0)
    reason = "the new samples around its new position are those of the robot"
    change = LandmarkChange(
        landmark.object_id,
        ChangeKind.REGISTERED,
        landmark.position,
        position,
        reliability,
        reason,
    )
    registered = replace(
        landmark,
        position=position,
        reliability=reliability,
        state=LandmarkState.LIVE,
        candidate=None,
        judged_from=evidence.robot,
    )
    return registered, change


def equation_2(reliability: float, similarity: float) -> float:
    """Return equation (2) for two numbers in [0, 1]; 0.5 where it is 0 / 0."""
    agreeing = similarity * reliability
    whole = agreeing + (1.0 - similarity) * (1.0 - reliability)
    return INITIAL_RELIABILITY if whole == 0.0 else agreeing / whole
