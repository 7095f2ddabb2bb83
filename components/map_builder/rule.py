"""The rule of the map: what one piece of evidence does to an object's reliability and place."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from cairn.components.map_builder.candidate import ANOTHER_M, ANOTHER_RAD, judge_candidate
from cairn.components.map_builder.objects import (
    CARRIED_OVER,
    Candidate,
    Change,
    Evidence,
    Kind,
    MapObject,
    State,
    Verdict,
)
from cairn.components.map_builder.place import Place, fuse
from cairn.components.map_builder.reliability import REMOVAL, update
from cairn.components.map_builder.viewpoints import NOWHERE, cell_of
from cairn.planar.poses import apart

# From poses that differ by more than this [m], [rad] an object is missed for reasons of their own.
_MISSED_M, _MISSED_RAD = 0.4, 0.5


Rule = Callable[[MapObject, Evidence, float], tuple[MapObject, Change | None]]
"""What evidence at a time [s] makes of an object: the new object and the map's change, if any."""


def judge(known: MapObject, evidence: Evidence, now_s: float) -> tuple[MapObject, Change | None]:
    """The rule that keeps a robot's map, at whatever time."""
    if evidence.verdict is Verdict.UNSEEN:
        return _judge_absence(known, evidence)
    if known.state is State.LIVE:
        return _judge_live(known, evidence, now_s)
    return judge_candidate(known, evidence, now_s)


def _judge_live(
    known: MapObject, evidence: Evidence, now_s: float
) -> tuple[MapObject, Change | None]:
    if evidence.verdict not in (Verdict.AGREES, Verdict.DISAGREES) or evidence.similarity == 0.5:
        return known, None
    # Sightings from one pose share their error: the first one counts.
    if known.judged_from is not None and not apart(
        known.judged_from, evidence.robot, ANOTHER_M, ANOTHER_RAD
    ):
        return known, None
    alone = evidence.alone
    reliability = update(known.reliability, evidence.weight)
    if evidence.verdict is Verdict.DISAGREES and not alone:
        # Others bear it out: they were right, and count as this one does.
        for _ in range(known.held_back):
            reliability = update(reliability, evidence.similarity)
    judged = replace(
        known,
        reliability=reliability,
        evidence_count=known.evidence_count + 1,
        judged_from=evidence.robot,
        held_back=known.held_back + 1 if alone else 0,
    )
    place = known.place
    if evidence.verdict is Verdict.AGREES and evidence.healthy and place is not None:
        here = cell_of(place.x, place.y, evidence.robot)
        judged = replace(judged, viewpoints=known.viewpoints.recognized(here), missed_from=None)
    if reliability <= REMOVAL:
        start = Candidate(evidence.implied, CARRIED_OVER, 1, evidence.robot)
        stays = known.stays.leave(place, now_s) if place else known.stays
        removed = replace(judged, state=State.RELOCATING, candidate=start, stays=stays)
        away_m = place.distance(evidence.implied) if place else math.nan
        reason = (
            f"reliability fell to {reliability:.2f}; the last sighting implies a place "
            f"{away_m:.2f} m away (distance of equation 1: {evidence.distance:.2f})"
        )
        return removed, Change(known.object_id, Kind.REMOVED, place, None, reliability, reason)
    if evidence.verdict is Verdict.AGREES and evidence.healthy and place is not None:
        return _refine(judged, place, evidence)
    return judged, None


def _judge_absence(known: MapObject, evidence: Evidence) -> tuple[MapObject, Change | None]:
    """Take that an object was not seen where it should have been.

    It counts from where the object is known to be recognized, and once the robot has moved on:
    what hides it now hides it in the next image, too.
    """
    place = known.place
    if known.state is not State.LIVE or not evidence.healthy or place is None:
        return known, None
    if known.missed_from is not None and not apart(
        known.missed_from, evidence.robot, _MISSED_M, _MISSED_RAD
    ):
        return known, None
    here = cell_of(place.x, place.y, evidence.robot)
    similarity = known.viewpoints.similarity_of_absence(here)
    if similarity is None:
        return known, None
    reliability = update(known.reliability, similarity)
    viewpoints = known.viewpoints.not_seen(here)
    missed = replace(
        known,
        reliability=reliability,
        evidence_count=known.evidence_count + 1,
        viewpoints=viewpoints,
        missed_from=evidence.robot,
        judged_from=None,  # to see it again now tells something new, from wherever
    )
    if reliability > REMOVAL:
        return missed, None
    reason = (
        f"reliability fell to {reliability:.2f}: it was not seen from the last "
        f"{len(viewpoints.absent)} of the places from which it used to be seen"
    )
    removed = replace(missed, state=State.RELOCATING, candidate=None, viewpoints=NOWHERE)
    return removed, Change(known.object_id, Kind.REMOVED, place, None, reliability, reason)


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
