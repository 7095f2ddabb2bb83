"""The chain of evidence and changes of an object, in words: `cairn map why`, request `why`."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import Any

from cairn import SECOND, CairnError
from cairn.visual_map.evidence_history import EvidenceSummary
from cairn.visual_map.landmark_store import LandmarkStore, StoredChange, StoredEvidence
from cairn.visual_map.landmarks import EvidenceVerdict, LandmarkRecord, LandmarkState


@dataclass(frozen=True)
class HistoryStep:
    """One event at `stamp_ns`, in words, and the reliability after it.

    `counted` is False for evidence that changed nothing, None for a change of the map and for a
    summary.
    """

    stamp_ns: int
    text: str
    reliability: float
    counted: bool | None
    verdict: str = ""
    similarity: float | None = None
    times: int = 1


def explain(store: LandmarkStore, called: str, last: int) -> dict[str, Any]:
    """Return what the map holds of an object and its `last` newest summarized steps, as JSON.

    `left_out` is the number of earlier steps. Raises `CairnError` if the map has no such object.
    """
    landmark = find_landmark(store, called)
    steps = summarize(history_of(store, landmark))
    return {
        "object": object_row(landmark),
        "now": describe_state(landmark),
        "steps": step_rows(steps[-last:]),
        "left_out": max(0, len(steps) - last),
    }


def step_rows(steps: Sequence[HistoryStep]) -> list[dict[str, Any]]:
    """Return steps as JSON, with their time."""
    return [asdict(step) | {"time": time_text(step.stamp_ns)} for step in steps]


def object_row(landmark: LandmarkRecord) -> dict[str, Any]:
    """Return what the map holds of a landmark, as JSON; positions in [m]."""
    position, found = landmark.position, landmark.candidate
    return {
        "object_id": landmark.object_id,
        "name": landmark.name,
        "x": position.x if position else None,
        "y": position.y if position else None,
        "reliability": landmark.reliability,
        "state": landmark.state.name.lower(),
        "evidence_count": landmark.evidence_count,
        "candidate_x": found.position.x if found else None,
        "candidate_y": found.position.y if found else None,
        "candidate_reliability": found.reliability if found else None,
    }


def time_text(stamp_ns: int) -> str | None:
    """Return a time [ns since 1970] in UTC; None for 0, which stands for the import."""
    if not stamp_ns:
        return None
    at = datetime.fromtimestamp(stamp_ns / SECOND, UTC)
    return at.isoformat(sep=" ", timespec="milliseconds")


def find_landmark(store: LandmarkStore, called: str) -> LandmarkRecord:
    """Return the landmark with this identifier or name; raise `CairnError` that lists them."""
    landmarks = store.landmarks()
    for landmark in landmarks:
        if called in (str(landmark.object_id), landmark.name):
            return landmark
    names = ", ".join(f"{one.object_id} ({one.name})" for one in landmarks[:20])
    more = ", ..." if len(landmarks) > 20 else ""
    raise CairnError(f"{store.path} has no object {called}; there are {names or 'none'}{more}")


def history_of(store: LandmarkStore, landmark: LandmarkRecord) -> list[HistoryStep]:
    """Return changes and evidence of a landmark, oldest first, and summaries of old evidence."""
    steps: list[HistoryStep] = []
    coming = deque(store.changes_of(landmark.object_id))
    position: tuple[float, float] | None = None
    before: StoredEvidence | None = None

    def pass_changes(until_ns: float) -> None:
        nonlocal position
        while coming and coming[0].stamp_ns <= until_ns:
            change = coming.popleft()
            position = change.new
            steps.append(_change_step(change))

    for summary in sorted(
        store.evidence_summaries_of(landmark.object_id), key=lambda one: one.last_ns
    ):
        pass_changes(summary.last_ns)
        steps.append(_summary_step(summary))
    for evidence in store.evidence_of(landmark.object_id):
        pass_changes(evidence.stamp_ns - 1)
        steps.append(_evidence_step(evidence, before, position))
        before = evidence
        pass_changes(evidence.stamp_ns)
    pass_changes(math.inf)
    return steps


def summarize(steps: Sequence[HistoryStep]) -> list[HistoryStep]:
    """Merge consecutive evidence that did not count and has the same verdict."""
    merged: list[HistoryStep] = []
    for step in steps:
        last = merged[-1] if merged else None
        both_ignored = last is not None and last.counted is False and step.counted is False
        if last is None or not both_ignored or last.verdict != step.verdict:
            merged.append(step)
            continue
        merged[-1] = replace(last, reliability=step.reliability, times=last.times + 1)
    return merged


def describe_state(landmark: LandmarkRecord) -> str:
    """Describe in a sentence what the map holds of a landmark now."""
    evidence = f"{landmark.evidence_count} pieces of evidence counted"
    if landmark.state is LandmarkState.LIVE and landmark.position is not None:
        x, y = landmark.position.x, landmark.position.y
        return f"is at ({x:.2f}, {y:.2f}) m, reliability {landmark.reliability:.2f}; {evidence}"
    found = landmark.candidate
    if found is None:
        return f"was removed and not seen since; {evidence}"
    return (
        f"has no position; it may be at ({found.position.x:.2f}, {found.position.y:.2f}) m, "
        f"supported by {found.observations} observations, reliability of that position "
        f"{found.reliability:.2f}; {evidence}"
    )


def _change_step(change: StoredChange) -> HistoryStep:
    return HistoryStep(change.stamp_ns, f"{change.kind}: {change.reason}", change.reliability, None)


def _summary_step(summary: EvidenceSummary) -> HistoryStep:
    verdict = summary.verdict.name.lower()
    first = datetime.fromtimestamp(summary.first_ns / SECOND, UTC)
    counted = "" if summary.counted else "; not counted"
    return HistoryStep(
        summary.last_ns,
        f"{summary.pieces} older pieces of evidence since {first:%Y-%m-%d %H:%M:%S}, of which only "
        f"a summary is kept: {verdict}; reliability {summary.reliability:.2f}{counted}",
        summary.reliability,
        None,  # it stands alone in the chain
        verdict,
    )


def _evidence_step(
    evidence: StoredEvidence,
    before: StoredEvidence | None,
    position: tuple[float, float] | None,
) -> HistoryStep:
    text = _describe(evidence, position)
    searched = evidence.state is LandmarkState.RELOCATING and position is None
    if searched and evidence.candidate_reliability is not None:
        reliability = evidence.candidate_reliability
        text = f"{text}; reliability of that position {reliability:.2f}"
    elif evidence.counted and before is not None:
        reliability = evidence.reliability
        text = f"{text}; reliability {before.reliability:.2f} -> {reliability:.2f}"
    else:
        reliability = evidence.reliability
        text = f"{text}; reliability {reliability:.2f}"
    x, y, theta = evidence.robot
    text = f"from ({x:.2f}, {y:.2f}, {math.degrees(theta):.0f}°) {text}"
    if not evidence.counted:
        text = f"{text}; not counted{_why_not_counted(evidence)}"
    return HistoryStep(
        evidence.stamp_ns,
        text,
        reliability,
        evidence.counted,
        evidence.verdict.name.lower(),
        evidence.similarity,
    )


def _describe(evidence: StoredEvidence, position: tuple[float, float] | None) -> str:
    x, y = evidence.implied
    if evidence.verdict is EvidenceVerdict.UNSEEN:
        return f"not seen at ({x:.2f}, {y:.2f}), where it should be in view"
    away = ""
    if position is not None:
        away = f", {math.hypot(x - position[0], y - position[1]):.2f} m from its position"
    seen = f"seen at ({x:.2f}, {y:.2f}){away}"
    agrees = evidence.verdict is EvidenceVerdict.AGREES
    if (agrees or evidence.verdict is EvidenceVerdict.DISAGREES) and position is not None:
        verb = "agrees" if agrees else "disagrees"
        return (
            f"{seen}: {verb}, distance {evidence.distance:.2f}, similarity "
            f"{evidence.similarity:.2f}"
        )
    return seen


def _why_not_counted(evidence: StoredEvidence) -> str:
    if evidence.verdict is EvidenceVerdict.FALSE_MATCH:
        return ": another landmark at this position may have been seen instead"
    if not evidence.healthy:
        return ": the robot's pose was not reliable"
    if evidence.verdict is EvidenceVerdict.NOT_CONVERGED:
        return ": the pose without this object had not converged"
    if evidence.verdict is EvidenceVerdict.UNSEEN:
        return ": it is not usually recognized from here, or was just missed from here"
    return ": seen from the same pose as before"
