"""What came of one pair in one run: which moves it noticed, what it got wrong."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cairn.planar.poses import Pose, apart, compose
from cairn.schemas.cairn_msgs import VisualMapChange
from cairn.tools.experiments.errors import course_of, found_after
from cairn.tools.experiments.series import Change, Move, PairSeries, Place, Sighting, WorldSeries

# An object that is mapped so near its place [m] is where the map says.
THERE_M = 0.3
# A sighting is of the object that stands nearest to where it puts it, if no farther than this [m].
_OF_IT_M = 1.0
# Sightings from poses that differ by more than this [m], [rad] are views of their own.
_VIEW_M, _VIEW_RAD = 0.15, 0.2
# Steps of the truth longer than this [m] are not driven: the robot was carried.
_CARRIED_M = 0.5


class MoveResult(BaseModel):
    """One object that was moved, and what a pair made of it.

    Sightings are those that truly are of it after the move; views are those from poses that differ
    by 0.15 m or 0.2 rad.
    """

    model_config = ConfigDict(extra="forbid")

    object_id: int
    moved_at: float = Field(description="When [s].")
    way: float = Field(description="How far it was moved [m].")
    beside: float = Field(description="Distance of its new place to the next other object [m].")
    sightings: int = Field(description="Sightings until the end of the run.")
    views: int = Field(description="Views until the end of the run.")
    noticed: bool = Field(
        description="It was removed after the move; or before, and then registered within 0.3 m of "
        "its new place."
    )
    removed_at: float | None = Field(description="When its old place was removed [s].")
    sightings_to_remove: int | None = Field(description="Sightings until then.")
    views_to_remove: int | None = Field(description="Views until then.")
    registered_at: float | None = Field(description="When it was first registered after that [s].")
    sightings_to_register: int | None = Field(description="Sightings from the move until then.")
    registered_error: float | None = Field(description="How far off its place that is [m].")


class PairResult(BaseModel):
    """One pair in one run."""

    model_config = ConfigDict(extra="forbid")

    method: str
    moves: list[MoveResult]
    removals: int = Field(description="Objects removed from the map, however often.")
    false_removals: list[str] = Field(description="Those that stood where the map had them.")
    registrations: int = Field(description="Objects registered at a new place.")
    false_registrations: list[str] = Field(description="Those more than 0.3 m off their place.")
    restored: int = Field(description="Objects that the map builder put back.")
    map_error: float | None = Field(
        description="Mean distance of live objects of the map from their true places, in the end "
        "[m]."
    )
    missing: list[int] = Field(description="Objects that are not live in the map in the end.")
    rms_before: float | None = Field(description="Position error before the change, rms [m].")
    rms_after: float | None = Field(description="Position error after the change, rms [m].")
    p95_after: float | None = Field(description="95 % of the position errors after it [m].")
    lost_after: float = Field(
        description="Share of the time after it with an error of more than 1 m, or without a pose."
    )
    found_s: float | None = Field(
        None,
        description="How long after it was carried off the robot was within 0.5 m and 0.5 rad of "
        "the truth [s]; null: never, or it was not carried off.",
    )


class RunResult(BaseModel):
    """One run, and what each pair made of it."""

    model_config = ConfigDict(extra="forbid")

    seed: int
    failure: str = Field("", description="Why the run counts for nothing; empty if it does count.")
    seconds: float = Field(0.0, description="How long the run was [s].")
    changed_at: float = Field(0.0, description="When the first thing was changed [s].")
    carried_at: float | None = Field(None, description="When the robot was carried off [s].")
    sightings: int = Field(0, description="Sightings of all objects.")
    mistaken: int = Field(0, description="Those of them that are of another object, or of none.")
    coverage: dict[int, tuple[int, int]] = Field(
        default_factory=dict, description="Sightings of each object before and after the change."
    )
    collisions: list[str] = Field(default_factory=list, description="What the robot touched.")
    pairs: list[PairResult] = Field(default_factory=list)


def judged_world(seed: int, world: WorldSeries, changed_at: float) -> RunResult:
    """What is true of a run, whatever a pair made of it."""
    genuine = _genuine(world)
    known = world.surveys[0][1] if world.surveys else {}
    ids = sorted({*known, *(one.object_id for one in genuine)})
    return RunResult(
        seed=seed,
        seconds=float(world.stamps[-1]) if world.stamps.size else 0.0,
        changed_at=changed_at,
        carried_at=carried_at(world),
        sightings=len(world.sightings),
        mistaken=len(world.sightings) - len(genuine),
        coverage={
            key: (
                sum(one.object_id == key and one.stamp <= changed_at for one in genuine),
                sum(one.object_id == key and one.stamp > changed_at for one in genuine),
            )
            for key in ids
        },
        collisions=list(world.collisions),
    )


def judged_pair(method: str, pair: PairSeries, world: WorldSeries, changed_at: float) -> PairResult:
    """What came of a pair."""
    end = float(world.stamps[-1])
    removals = [one for one in pair.changes if one.kind == VisualMapChange.REMOVED]
    registered = [one for one in pair.changes if one.kind == VisualMapChange.REGISTERED]
    in_the_end, truth = pair.map_at(math.inf), world.places(end)
    live = [key for key, one in in_the_end.items() if one.live and key in truth]
    errors = [math.dist(in_the_end[key].place, truth[key]) for key in live]
    course = course_of(pair, world, end)
    before, after = course.between(0.0, changed_at), course.between(changed_at, end)
    carried = carried_at(world)
    return PairResult(
        method=method,
        moves=[_judged_move(move, pair, world) for move in world.moves],
        removals=len(removals),
        false_removals=[_told(one) for one in removals if stood_there(one, world)],
        registrations=len(registered),
        false_registrations=[_told(one) for one in registered if not _is_there(one, world)],
        restored=sum(one.kind == VisualMapChange.RESTORED for one in pair.changes),
        map_error=float(np.mean(errors)) if errors else None,
        missing=sorted(truth.keys() - set(live)),
        rms_before=_root_mean_square(before.position_error),
        rms_after=_root_mean_square(after.position_error),
        p95_after=_percentile(after.position_error, 95),
        lost_after=after.lost_share if after.stamps.size else 0.0,
        found_s=None if carried is None else found_after(pair, world, carried),
    )


def stood_there(removal: Change, world: WorldSeries) -> bool:
    """Whether a removed object stood where the map had it: within 0.3 m, or half of its move."""
    true = world.places(removal.stamp).get(removal.object_id)
    if removal.old is None or true is None:
        return False
    moved = [m for m in world.moves if m.object_id == removal.object_id]
    ways = [math.dist(m.old, m.new) for m in moved if m.stamp <= removal.stamp]
    return math.dist(removal.old, true) <= min([THERE_M, *(way / 2 for way in ways)])


def carried_at(world: WorldSeries) -> float | None:
    """When the robot was carried off, as its true poses show; None if it was not."""
    steps = np.hypot(*np.diff(world.poses[:, :2], axis=0).T)
    jumps = np.flatnonzero(steps > _CARRIED_M)
    return float(world.stamps[jumps[0] + 1]) if jumps.size else None


def sightings_of(world: WorldSeries, object_id: int) -> list[tuple[float, Pose]]:
    """When [s], and from which true pose, an object was truly seen."""
    mine = [one for one in _genuine(world) if one.object_id == object_id]
    poses = world.truth(np.array([one.stamp for one in mine]))
    return [(one.stamp, (x, y, a)) for one, (x, y, a) in zip(mine, poses.tolist(), strict=True)]


def views(seen: list[tuple[float, Pose]]) -> list[float]:
    """When [s] those of the sightings were that differ from the last one that counted."""
    counted: list[tuple[float, Pose]] = []
    for stamp, pose in seen:
        if not counted or apart(counted[-1][1], pose, _VIEW_M, _VIEW_RAD):
            counted.append((stamp, pose))
    return [stamp for stamp, _ in counted]


def _judged_move(move: Move, pair: PairSeries, world: WorldSeries) -> MoveResult:
    seen = [one for one in sightings_of(world, move.object_id) if one[0] > move.stamp]
    own_views = views(seen)
    changes = [one for one in pair.changes if one.object_id == move.object_id]
    removal = _first(changes, VisualMapChange.REMOVED, move.stamp)
    # One that had been removed before, falsely, is noticed by being registered.
    since = move.stamp if removal is None else removal.stamp
    found = _first(changes, VisualMapChange.REGISTERED, since)
    others = [place for key, place in world.places(move.stamp).items() if key != move.object_id]
    return MoveResult(
        object_id=move.object_id,
        moved_at=move.stamp,
        way=math.dist(move.old, move.new),
        beside=min((math.dist(move.new, other) for other in others), default=math.inf),
        sightings=len(seen),
        views=len(own_views),
        noticed=removal is not None or (found is not None and _is_there(found, world)),
        removed_at=removal.stamp if removal else None,
        sightings_to_remove=_until([stamp for stamp, _ in seen], removal),
        views_to_remove=_until(own_views, removal),
        registered_at=found.stamp if found else None,
        sightings_to_register=_until([stamp for stamp, _ in seen], found),
        registered_error=_error(found, world),
    )


def _genuine(world: WorldSeries) -> list[Sighting]:
    """The sightings that are of the object that they name."""
    poses = world.truth(np.array([one.stamp for one in world.sightings]))
    found = []
    for one, (x, y, theta) in zip(world.sightings, poses.tolist(), strict=True):
        reach, bearing = one.range_m, one.bearing
        ahead = (reach * math.cos(bearing), reach * math.sin(bearing), 0.0)
        put = compose((x, y, theta), ahead)[:2]
        off = {key: math.dist(put, place) for key, place in world.places(one.stamp).items()}
        nearest = min(off, key=lambda key: off[key], default=None)
        if nearest == one.object_id and off[nearest] <= _OF_IT_M:
            found.append(one)
    return found


def _first(changes: list[Change], kind: int, since: float) -> Change | None:
    return next((one for one in changes if one.kind == kind and one.stamp > since), None)


def _until(stamps: list[float], change: Change | None) -> int | None:
    return None if change is None else sum(stamp <= change.stamp for stamp in stamps)


def _error(registration: Change | None, world: WorldSeries) -> float | None:
    if registration is None or registration.new is None:
        return None
    true: Place | None = world.places(registration.stamp).get(registration.object_id)
    return None if true is None else math.dist(registration.new, true)


def _is_there(registration: Change, world: WorldSeries) -> bool:
    error = _error(registration, world)
    return error is not None and error <= THERE_M


def _told(change: Change) -> str:
    return f"object {change.object_id} at {change.stamp:.1f} s: {change.reason}"


def _root_mean_square(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _percentile(values: np.ndarray, percent: float) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if known.size else None
