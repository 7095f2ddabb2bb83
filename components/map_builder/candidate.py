"""Where an object that was removed, or is not known, may stand now: a candidate place."""

from __future__ import annotations

from dataclasses import replace

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
from cairn.components.map_builder.place import Place, average, place_similarity, squared_distance
from cairn.components.map_builder.reliability import REGISTRATION, update
from cairn.components.map_builder.viewpoints import NOWHERE
from cairn.planar.poses import apart

# A candidate no farther than this [m] from where the object stood has not moved, if its sightings
# are not more exact than that: normalized distance squared (2 dof, 90 %).
_UNMOVED_M, _UNMOVED_NIS = 0.35, 4.6
# From poses that differ by more than this [m], [rad] sightings are independent.
ANOTHER_M, ANOTHER_RAD = 0.15, 0.2


def judge_candidate(
    known: MapObject, evidence: Evidence, now_s: float
) -> tuple[MapObject, Change | None]:
    """What a sighting makes of an object that has no place in the map: a candidate for one.

    Places that sightings from different poses agree on are registered; not those of an object that
    is now here, now there.
    """
    if not evidence.healthy or evidence.verdict is Verdict.NOT_CONVERGED:
        return known, None
    if known.stays.doubted(now_s):
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
    place = candidate.place
    if similarity >= 0.5:
        place = average(place, candidate.sightings, evidence.implied)
    moved = Candidate(place, reliability, candidate.sightings + 1, evidence.robot)
    if reliability <= REGISTRATION:
        return replace(seen, candidate=moved), None
    stays = known.stays.come(place, now_s)
    if stays.doubted(now_s):
        return _doubted(replace(seen, stays=stays))
    return _register(replace(seen, stays=stays), moved)


def _doubted(known: MapObject) -> tuple[MapObject, Change | None]:
    reason = (
        "it is seen now here, now there: two things look alike; it is not relied on for ten "
        "minutes. Take one of them away, or make them differ"
    )
    change = Change(known.object_id, Kind.REMOVED, known.place, None, CARRIED_OVER, reason)
    return replace(known, candidate=None), change


def _register(known: MapObject, found: Candidate) -> tuple[MapObject, Change | None]:
    old = known.place
    unmoved = old is not None and _unmoved(old, found.place)
    place = old if unmoved and old is not None else found.place
    registered = replace(
        known,
        place=place,
        reliability=found.reliability,
        state=State.LIVE,
        candidate=None,
        judged_from=found.seen_from,
        viewpoints=NOWHERE,
        missed_from=None,
        held_back=0,
    )
    if unmoved and old is not None:
        kind = Kind.RESTORED
        reason = f"seen again {old.distance(found.place):.2f} m from its place: it had not moved"
    else:
        kind = Kind.REGISTERED
        reason = f"{found.sightings} sightings from different poses agree on the new place"
    return registered, Change(known.object_id, kind, old, place, found.reliability, reason)


def _unmoved(old: Place, found: Place) -> bool:
    return old.distance(found) <= _UNMOVED_M and squared_distance(old, found) <= _UNMOVED_NIS
