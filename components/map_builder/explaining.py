"""Why the map says what it says of an object: the chain of evidence and changes, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cairn import CairnError
from cairn.components.map_builder.objects import MapObject, State, Verdict
from cairn.components.map_builder.store import KeptChange, KeptEvidence, MapStore


@dataclass(frozen=True)
class Step:
    """What happened at `stamp_ns`, in words, and the reliability after it.

    `counted` is False for evidence that changed nothing, None for a change of the map.
    """

    stamp_ns: int
    what: str
    reliability: float
    counted: bool | None
    verdict: str = ""
    similarity: float | None = None
    times: int = 1


def object_called(store: MapStore, called: str) -> MapObject:
    """The object of a map by number or name; `CairnError` names those that there are."""
    objects = store.objects()
    for known in objects:
        if called in (str(known.object_id), known.name):
            return known
    names = ", ".join(f"{known.object_id} ({known.name})" for known in objects[:20])
    more = ", ..." if len(objects) > 20 else ""
    raise CairnError(f"{store.path} has no object {called}; there are {names or 'none'}{more}")


def chain_of(store: MapStore, known: MapObject) -> list[Step]:
    """All evidence and changes of an object, the oldest first."""
    steps: list[Step] = []
    changes = list(store.changes_of(known.object_id))
    place: tuple[float, float] | None = None
    before: KeptEvidence | None = None
    for evidence in store.evidence_of(known.object_id):
        while changes and changes[0].stamp_ns < evidence.stamp_ns:
            change = changes.pop(0)
            place = change.new
            steps.append(_of_change(change))
        steps.append(_of_evidence(evidence, before, place))
        before = evidence
        while changes and changes[0].stamp_ns == evidence.stamp_ns:
            change = changes.pop(0)
            place = change.new
            steps.append(_of_change(change))
    return [*steps, *map(_of_change, changes)]


def shortened(steps: Sequence[Step]) -> list[Step]:
    """The same with what did not count, and said the same in a row, as one step."""
    short: list[Step] = []
    for step in steps:
        last = short[-1] if short else None
        alike = last is not None and last.counted is False and step.counted is False
        if last is None or not alike or last.verdict != step.verdict:
            short.append(step)
            continue
        short[-1] = Step(
            last.stamp_ns,
            last.what,
            step.reliability,
            counted=False,
            verdict=last.verdict,
            similarity=last.similarity,
            times=last.times + 1,
        )
    return short


def standing_of(known: MapObject) -> str:
    """What the map holds of an object now, in a sentence."""
    evidence = f"{known.evidence_count} pieces of evidence counted"
    if known.state is State.LIVE and known.place is not None:
        x, y = known.place.x, known.place.y
        return f"stands at ({x:.2f}, {y:.2f}) m, reliability {known.reliability:.2f}; {evidence}"
    found = known.candidate
    if found is None:
        return f"was removed and not seen since; {evidence}"
    return (
        f"has no place; it may stand at ({found.place.x:.2f}, {found.place.y:.2f}) m, seen there "
        f"from {found.sightings} places, reliability of that {found.reliability:.2f}; {evidence}"
    )


def _of_change(change: KeptChange) -> Step:
    return Step(change.stamp_ns, f"{change.kind}: {change.reason}", change.reliability, None)


def _of_evidence(
    evidence: KeptEvidence, before: KeptEvidence | None, place: tuple[float, float] | None
) -> Step:
    said = _said(evidence, place)
    searched = evidence.state is State.RELOCATING and place is None
    if searched and evidence.candidate_reliability is not None:
        reliability = evidence.candidate_reliability
        said = f"{said}; reliability of that place {reliability:.2f}"
    elif evidence.counted and before is not None:
        reliability = evidence.reliability
        said = f"{said}; reliability {before.reliability:.2f} -> {reliability:.2f}"
    else:
        reliability = evidence.reliability
        said = f"{said}; reliability {reliability:.2f}"
    x, y, theta = evidence.robot
    said = f"from ({x:.2f}, {y:.2f}, {math.degrees(theta):.0f}°) {said}"
    if not evidence.counted:
        said = f"{said}; not counted{_why_not(evidence)}"
    return Step(
        evidence.stamp_ns,
        said,
        reliability,
        evidence.counted,
        evidence.verdict.name.lower(),
        evidence.similarity,
    )


def _said(evidence: KeptEvidence, place: tuple[float, float] | None) -> str:
    x, y = evidence.implied
    if evidence.verdict is Verdict.UNSEEN:
        return f"not seen at ({x:.2f}, {y:.2f}), where it should be in view"
    away = ""
    if place is not None:
        away = f", {math.hypot(x - place[0], y - place[1]):.2f} m from its place"
    seen = f"seen at ({x:.2f}, {y:.2f}){away}"
    if evidence.verdict in (Verdict.AGREES, Verdict.DISAGREES) and place is not None:
        verb = "agrees" if evidence.verdict is Verdict.AGREES else "disagrees"
        return (
            f"{seen}: {verb}, distance {evidence.distance:.2f}, {evidence.similarity:.2f} similar"
        )
    return seen


def _why_not(evidence: KeptEvidence) -> str:
    if evidence.verdict is Verdict.FALSE_MATCH:
        return ": another object stands there, which may be what was seen"
    if not evidence.healthy:
        return ": the robot was not sure of its pose"
    if evidence.verdict is Verdict.NOT_CONVERGED:
        return ": the pose without it could not tell"
    if evidence.verdict is Verdict.UNSEEN:
        return ": it is not known to be recognized from here, or was missed from here just now"
    return ": seen from the same pose as before"
