"""The paper's rule as it stands, to compare with: equation (2) unbounded, every sighting counts."""

from __future__ import annotations

from dataclasses import replace

from cairn.components.map_builder.objects import (
    Candidate,
    Change,
    Evidence,
    Kind,
    MapObject,
    State,
    Verdict,
)
from cairn.components.map_builder.place import Place
from cairn.components.map_builder.reliability import INITIAL

_REMOVAL, _REGISTRATION = 0.1, 0.5


def judge_to_the_letter(
    known: MapObject, evidence: Evidence, now_s: float
) -> tuple[MapObject, Change | None]:
    """What `evidence` makes of an object by section 3.2 of the paper, whatever the time."""
    del now_s
    if evidence.verdict is Verdict.UNSEEN or evidence.verdict is Verdict.NOT_CONVERGED:
        return known, None
    seen = replace(known, evidence_count=known.evidence_count + 1)
    if known.state is State.LIVE:
        reliability = equation_2(known.reliability, evidence.weight)
        if reliability >= _REMOVAL:
            return replace(seen, reliability=reliability), None
        # New samples are drawn around the place that this sighting gives, and their reliability
        # begins anew.
        there = Candidate(evidence.implied, INITIAL, 1, evidence.robot)
        reason = f"reliability fell to {reliability:.3g}"
        change = Change(known.object_id, Kind.REMOVED, known.place, None, reliability, reason)
        removed = replace(seen, reliability=reliability, state=State.RELOCATING, candidate=there)
        return removed, change
    return _registered(seen, evidence.implied, evidence)


def _registered(
    known: MapObject, there: Place, evidence: Evidence
) -> tuple[MapObject, Change | None]:
    """Register where this sighting places the object: the samples that are drawn around it are
    those of the robot, so their similarity is 1 and the reliability rises above 0.5 at once.
    """
    reliability = equation_2(INITIAL, 1.0)
    reason = "the new samples around its new place are those of the robot"
    change = Change(known.object_id, Kind.REGISTERED, known.place, there, reliability, reason)
    registered = replace(
        known,
        place=there,
        reliability=reliability,
        state=State.LIVE,
        candidate=None,
        judged_from=evidence.robot,
    )
    return registered, change


def equation_2(reliability: float, similarity: float) -> float:
    """Equation (2) for any two numbers in [0, 1]; 0.5 where it is 0 / 0."""
    agreeing = similarity * reliability
    whole = agreeing + (1.0 - similarity) * (1.0 - reliability)
    return INITIAL if whole == 0.0 else agreeing / whole
