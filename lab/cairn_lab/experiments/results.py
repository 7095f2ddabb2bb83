"""Judges one method in one run by the ground truth: noticed moves, false changes, pose errors."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cairn.planar.poses import Pose, apart, compose
from cairn.schemas.cairn_msgs import VisualMapChange
from cairn_lab.experiments.series import (
    MethodSeries,
    ObservedObject,
    Position,
    RecordedChange,
    TrueMove,
    WorldSeries,
    error_curve,
    relocalization_time,
)

# A landmark within this distance [m] of the object's true position is correct.
CORRECT_M = 0.3
# An observation is of the object nearest to the position that it implies, within this distance [m].
_SAME_OBJECT_M = 1.0
# Observations from poses that differ by more than this [m], [rad] are of different viewpoints.
_VIEWPOINT_M, _VIEWPOINT_RAD = 0.15, 0.2
# Steps of the ground truth longer than this [m] were not driven: the robot was kidnapped.
_KIDNAPPED_M = 0.5


class MoveResult(BaseModel):
    """One moved object, and how one method followed the move.

    Observations are those that are truly of the object after the move; viewpoints are poses of them
    that differ by 0.15 m or 0.2 rad.
    """

    model_config = ConfigDict(extra="forbid")

    object_id: int
    moved_at: float = Field(description="Time of the move [s].")
    distance: float = Field(description="Distance of the move [m].")
    neighbor_distance: float = Field(
        description="Distance of the new position from the nearest other object [m]."
    )
    observations: int = Field(description="Observations until the end of the run.")
    viewpoints: int = Field(description="Viewpoints until the end of the run.")
    noticed: bool = Field(
        description="The landmark was removed after the move; or removed before, and then "
        "registered within 0.3 m of the new position."
    )
    removed_at: float | None = Field(description="When the landmark was removed [s].")
    observations_to_remove: int | None = Field(description="Observations from the move until then.")
    viewpoints_to_remove: int | None = Field(description="Viewpoints from the move until then.")
    registered_at: float | None = Field(description="When it was first registered after that [s].")
    observations_to_register: int | None = Field(
        description="Observations from the move until then."
    )
    registration_error: float | None = Field(
        description="Distance of the registered from the true position [m]."
    )


class MethodResult(BaseModel):
    """One method in one run."""

    model_config = ConfigDict(extra="forbid")

    method: str
    moves: list[MoveResult]
    removals: int = Field(description="Removals of landmarks from the map.")
    false_removals: list[str] = Field(
        description="Removals of landmarks that stood where the map had them."
    )
    registrations: int = Field(description="Registrations of landmarks at a new position.")
    false_registrations: list[str] = Field(
        description="Registrations more than 0.3 m from the true position."
    )
    restored: int = Field(description="Landmarks that the map builder restored.")
    map_error: float | None = Field(
        description="Mean distance of the live landmarks from their true positions at the end [m]."
    )
    missing: list[int] = Field(description="Objects that are not live in the map at the end.")
    rms_before: float | None = Field(description="Position error before the change, rms [m].")
    rms_after: float | None = Field(description="Position error after the change, rms [m].")
    p95_after: float | None = Field(
        description="95th percentile of the position error after the change [m]."
    )
    lost_after: float = Field(
        description="Share of the time after the change with an error of more than 1 m, or without "
        "a pose."
    )
    relocalized_s: float | None = Field(
        None,
        description="Time from the kidnapping until the estimate was within 0.5 m and 0.5 rad of "
        "the truth [s]; null: never, or the robot was not kidnapped.",
    )


class ExperimentRunResult(BaseModel):
    """One run, and the result of each method in it."""

    model_config = ConfigDict(extra="forbid")

    seed: int
    seconds: float = Field(0.0, description="Duration of the run [s].")
    changed_at: float = Field(0.0, description="Time of the first change [s].")
    kidnapped_at: float | None = Field(None, description="When the robot was kidnapped [s].")
    observations: int = Field(0, description="Observations of all objects.")
    false_matches: int = Field(
        0, description="Observations that are of another object, or of no object."
    )
    coverage: dict[int, tuple[int, int]] = Field(
        default_factory=dict,
        description="Observations of each object before and after the change.",
    )
    collisions: list[str] = Field(default_factory=list, description="Obstacles that it touched.")
    methods: list[MethodResult] = Field(default_factory=list)


def judge_run(seed: int, world: WorldSeries, changed_at: float) -> ExperimentRunResult:
    """Return the results of a run that no method influences."""
    correct = _correct_observations(world)
    known = world.surveys[0][1] if world.surveys else {}
    ids = sorted({*known, *(one.object_id for one in correct)})
    return ExperimentRunResult(
        seed=seed,
        seconds=float(world.stamps[-1]) if world.stamps.size else 0.0,
        changed_at=changed_at,
        kidnapped_at=kidnapping_time(world),
        observations=len(world.observations),
        false_matches=len(world.observations) - len(correct),
        coverage={
            key: (
                sum(one.object_id == key and one.stamp <= changed_at for one in correct),
                sum(one.object_id == key and one.stamp > changed_at for one in correct),
            )
            for key in ids
        },
        collisions=list(world.collisions),
    )


def judge_method(
    method: str, series: MethodSeries, world: WorldSeries, changed_at: float
) -> MethodResult:
    """Return the result of one method in a run."""
    end = float(world.stamps[-1])
    removals = [one for one in series.changes if one.kind == VisualMapChange.REMOVED]
    registered = [one for one in series.changes if one.kind == VisualMapChange.REGISTERED]
    landmarks, truth = series.map_at(math.inf), world.positions(end)
    live = [key for key, one in landmarks.items() if one.live and key in truth]
    errors = [math.dist(landmarks[key].position, truth[key]) for key in live]
    curve = error_curve(series, world, end)
    before, after = curve.between(0.0, changed_at), curve.between(changed_at, end)
    kidnapped = kidnapping_time(world)
    return MethodResult(
        method=method,
        moves=[_judge_move(move, series, world) for move in world.moves],
        removals=len(removals),
        false_removals=[_describe(one) for one in removals if _is_false_removal(one, world)],
        registrations=len(registered),
        false_registrations=[_describe(one) for one in registered if not _is_correct(one, world)],
        restored=sum(one.kind == VisualMapChange.RESTORED for one in series.changes),
        map_error=float(np.mean(errors)) if errors else None,
        missing=sorted(truth.keys() - set(live)),
        rms_before=_root_mean_square(before.position_error),
        rms_after=_root_mean_square(after.position_error),
        p95_after=_percentile(after.position_error, 95),
        lost_after=after.lost_share if after.stamps.size else 0.0,
        relocalized_s=None if kidnapped is None else relocalization_time(series, world, kidnapped),
    )


def kidnapping_time(world: WorldSeries) -> float | None:
    """Return when [s] the robot was kidnapped, from its true poses; None if it was not."""
    steps = np.hypot(*np.diff(world.poses[:, :2], axis=0).T)
    jumps = np.flatnonzero(steps > _KIDNAPPED_M)
    return float(world.stamps[jumps[0] + 1]) if jumps.size else None


def viewpoint_stamps(observed: list[tuple[float, Pose]]) -> list[float]:
    """Return the stamps [s] of the observations whose pose differs from the last one counted."""
    counted: list[tuple[float, Pose]] = []
    for stamp, pose in observed:
        if not counted or apart(counted[-1][1], pose, _VIEWPOINT_M, _VIEWPOINT_RAD):
            counted.append((stamp, pose))
    return [stamp for stamp, _ in counted]


def _is_false_removal(removal: RecordedChange, world: WorldSeries) -> bool:
    """Return whether the object stood where the map had it: within 0.3 m, or half of its move."""
    true = world.positions(removal.stamp).get(removal.object_id)
    if removal.old is None or true is None:
        return False
    moves = [m for m in world.moves if m.object_id == removal.object_id]
    distances = [math.dist(m.old, m.new) for m in moves if m.stamp <= removal.stamp]
    return math.dist(removal.old, true) <= min([CORRECT_M, *(one / 2 for one in distances)])


def _judge_move(move: TrueMove, series: MethodSeries, world: WorldSeries) -> MoveResult:
    observed = [one for one in _observed_from(world, move.object_id) if one[0] > move.stamp]
    stamps, viewpoints = [stamp for stamp, _ in observed], viewpoint_stamps(observed)
    changes = [one for one in series.changes if one.object_id == move.object_id]
    removal = _first(changes, VisualMapChange.REMOVED, move.stamp)
    # The move of a landmark that was removed too early is noticed by its registration.
    since = move.stamp if removal is None else removal.stamp
    registration = _first(changes, VisualMapChange.REGISTERED, since)
    others = [at for key, at in world.positions(move.stamp).items() if key != move.object_id]
    return MoveResult(
        object_id=move.object_id,
        moved_at=move.stamp,
        distance=math.dist(move.old, move.new),
        neighbor_distance=min((math.dist(move.new, other) for other in others), default=math.inf),
        observations=len(observed),
        viewpoints=len(viewpoints),
        noticed=removal is not None
        or (registration is not None and _is_correct(registration, world)),
        removed_at=removal.stamp if removal else None,
        observations_to_remove=_count_until(stamps, removal),
        viewpoints_to_remove=_count_until(viewpoints, removal),
        registered_at=registration.stamp if registration else None,
        observations_to_register=_count_until(stamps, registration),
        registration_error=_registration_error(registration, world),
    )


def _observed_from(world: WorldSeries, object_id: int) -> list[tuple[float, Pose]]:
    """Return when [s], and from which true pose, an object was correctly recognized."""
    mine = [one for one in _correct_observations(world) if one.object_id == object_id]
    poses = world.true_poses(np.array([one.stamp for one in mine]))
    return [(one.stamp, (x, y, a)) for one, (x, y, a) in zip(mine, poses.tolist(), strict=True)]


def _correct_observations(world: WorldSeries) -> list[ObservedObject]:
    """Return the observations that are of the object that they name."""
    poses = world.true_poses(np.array([one.stamp for one in world.observations]))
    correct = []
    for one, (x, y, theta) in zip(world.observations, poses.tolist(), strict=True):
        ahead = (one.range_m * math.cos(one.bearing), one.range_m * math.sin(one.bearing), 0.0)
        implied = compose((x, y, theta), ahead)[:2]
        off = {key: math.dist(implied, at) for key, at in world.positions(one.stamp).items()}
        nearest = min(off, key=lambda key: off[key], default=None)
        if nearest == one.object_id and off[nearest] <= _SAME_OBJECT_M:
            correct.append(one)
    return correct


def _first(changes: list[RecordedChange], kind: int, since: float) -> RecordedChange | None:
    return next((one for one in changes if one.kind == kind and one.stamp > since), None)


def _count_until(stamps: list[float], change: RecordedChange | None) -> int | None:
    return None if change is None else sum(stamp <= change.stamp for stamp in stamps)


def _registration_error(registration: RecordedChange | None, world: WorldSeries) -> float | None:
    if registration is None or registration.new is None:
        return None
    true: Position | None = world.positions(registration.stamp).get(registration.object_id)
    return None if true is None else math.dist(registration.new, true)


def _is_correct(registration: RecordedChange, world: WorldSeries) -> bool:
    error = _registration_error(registration, world)
    return error is not None and error <= CORRECT_M


def _describe(change: RecordedChange) -> str:
    return f"object {change.object_id} at {change.stamp:.1f} s: {change.reason}"


def _root_mean_square(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _percentile(values: np.ndarray, percent: float) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if known.size else None
