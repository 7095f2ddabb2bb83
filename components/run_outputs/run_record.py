"""The record of a run: tracks, objects and their moves, missions. It is bounded, over days as well.

What is beyond the bounds becomes a summary: errors and driven distance are sums, tracks get
thinner, older missions are counted by state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, wrap_all

# A gap of the estimate longer than this is not interpolated [ns].
_LONGEST_GAP_NS = 1_000_000_000
_NS = 1e-9
# A longer step of the truth is not driven: the robot was carried [m].
_CARRIED_M = 0.5

MOST_RECENT: Final = 2_000
"""Poses of a track kept at full rate: minutes, so the other track of the same time is known."""
MOST_DRAWN: Final = 4_000
"""Older poses kept of a track, for the picture."""
MOST_OBJECTS: Final = 1_000
"""Objects of the visual map."""
MOST_RELIABILITIES: Final = 100_000
"""Recorded reliabilities of all objects together."""
MOST_MOVES: Final = 100
"""Moves of one object."""
MOST_MISSIONS: Final = 1_000
"""Missions kept with their goals."""
MOST_GOALS: Final = 10_000
"""Goals of these missions."""
MOST_COLLISIONS: Final = 1_000
"""Collisions kept with time and position."""
MOST_PORTS: Final = 2_000
"""Ports whose counters are kept."""
_LONGEST_TEXT: Final = 500  # characters of names and reasons

Position = tuple[float, float]


@dataclass
class ObjectMove:
    """One move: the position that the object left, None if the map had none, and the times (int
    ns).
    """

    left: Position | None
    removed_at: int | None
    registered_at: int | None = None


@dataclass
class ObjectMoves:
    """The moves of one object that are valid: those that the map has undone are removed."""

    standing: list[ObjectMove] = field(default_factory=list)

    @property
    def last(self) -> ObjectMove:
        """The last move; one without times if the object never moved."""
        return self.standing[-1] if self.standing else ObjectMove(None, None)

    def removed(self, stamp: int, left: Position | None) -> None:
        """Add that the object was removed from a position."""
        self._add(ObjectMove(left, stamp))

    def registered(self, stamp: int) -> None:
        """Add that the object was registered at a new position."""
        if not self.standing or self.standing[-1].registered_at is not None:
            self._add(ObjectMove(None, None))
        self.standing[-1].registered_at = stamp

    def restored(self, position: Position | None) -> None:
        """Undo moves: the object is back at a position it had left; None: it has no position
        again.
        """
        if position is not None:
            del self.standing[self._since(position) :]
            return
        if self.standing and self.standing[-1].registered_at is None:
            self.standing.pop()
        if self.standing and self.standing[-1].removed_at is None:
            self.standing.pop()
        elif self.standing:
            self.standing[-1].registered_at = None

    def _add(self, move: ObjectMove) -> None:
        self.standing.append(move)
        del self.standing[:-MOST_MOVES]

    def _since(self, position: Position) -> int:
        """Return the index of the move that left this position, which observations may have
        refined by centimeters since.
        """
        left = [move.left for move in self.standing]
        apart = [math.inf if one is None else math.dist(one, position) for one in left]
        return min(reversed(range(len(apart))), key=apart.__getitem__, default=0)


@dataclass
class ObjectRecord:
    """One object of the visual map: its first position in the map, its current one, and its
    moves.
    """

    object_id: int
    name: str = ""
    map_position: tuple[float, float] | None = None
    position: tuple[float, float] | None = None
    true_position: tuple[float, float] | None = None
    reliability: float = 0.5
    state: str = "unknown"
    moves: ObjectMoves = field(default_factory=ObjectMoves)
    history: list[tuple[int, float]] = field(default_factory=list)

    def add_reliability(self, stamp: int, reliability: float, most: int) -> None:
        """Add a changed reliability to the history, of which at most `most` entries are kept."""
        self.reliability = reliability
        if self.history and self.history[-1][1] == reliability:
            return
        self.history.append((stamp, reliability))
        if len(self.history) > most:
            del self.history[1:-1:2]


@dataclass
class Track:
    """A track (x, y [m], heading [rad]): its newest poses with stamps [ns], and every
    `stride`-th of the older ones, for drawing.
    """

    stamps: list[int] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    older: list[Pose] = field(default_factory=list)
    stride: int = 1
    passed: int = 0  # older poses since the last one that was kept

    def __len__(self) -> int:
        """Return the number of newest poses."""
        return len(self.stamps)

    def add(self, stamp: int, pose: Pose) -> None:
        """Append a pose."""
        self.stamps.append(stamp)
        self.poses.append(pose)

    def thin(self, stamp: int) -> None:
        """Count the poses up to a time [ns] among the older ones."""
        entries = list(zip(self.stamps, self.poses, strict=True))
        for pose in (pose for at, pose in entries if at <= stamp):
            self.passed = (self.passed + 1) % self.stride
            if self.passed == 0:
                self.older.append(pose)
                if len(self.older) > MOST_DRAWN:
                    del self.older[::2]
                    self.stride *= 2
        self.stamps = [at for at in self.stamps if at > stamp]
        self.poses = [pose for at, pose in entries if at > stamp]

    def to_draw(self) -> NDArray[np.float64]:
        """Return the kept poses, N x 3 (m, m, rad)."""
        return np.array(self.older + self.poses, dtype=np.float64).reshape(-1, 3)

    def sorted(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return stamps [ns] and poses (N x 3) of the newest poses, ordered by time."""
        stamps = np.array(self.stamps, dtype=np.int64)
        order = np.argsort(stamps, kind="stable")
        return stamps[order], np.array(self.poses, dtype=np.float64).reshape(-1, 3)[order]


@dataclass(frozen=True)
class ErrorSums:
    """Sums of the errors of an estimated track: squares [m^2, rad^2], and the largest one [m]."""

    count: int = 0
    position_squares: float = 0.0
    heading_squares: float = 0.0
    position_max: float | None = None

    def plus(self, error: TrackError) -> ErrorSums:
        """Return the sums with further errors."""
        if not len(error.stamps):
            return self
        largest = float(error.position.max())
        return ErrorSums(
            self.count + len(error.stamps),
            self.position_squares + float(np.sum(error.position**2)),
            self.heading_squares + float(np.sum(error.heading**2)),
            largest if self.position_max is None else max(largest, self.position_max),
        )

    @property
    def position_rmse(self) -> float | None:
        """Root mean square of the position error [m]; None without a common time."""
        return math.sqrt(self.position_squares / self.count) if self.count else None

    @property
    def heading_rmse(self) -> float | None:
        """Root mean square of the heading error [rad]; None without a common time."""
        return math.sqrt(self.heading_squares / self.count) if self.count else None


@dataclass
class PortCounters:
    """Messages that a port dropped and rejected: in the newest process of its component, which is
    the one after `restarts` restarts, and in those before.
    """

    restarts: int
    newest: tuple[int, int]
    before: tuple[int, int] = (0, 0)

    def update(self, restarts: int, counts: tuple[int, int]) -> None:
        """Set the counters of a process; those of an older process are ignored."""
        if restarts > self.restarts:
            self.restarts, self.before = restarts, (self.total(0), self.total(1))
        if restarts == self.restarts:
            self.newest = counts

    def total(self, which: int) -> int:
        """Return one of the counters, summed over all processes."""
        return self.before[which] + self.newest[which]


@dataclass
class RunRecord:
    """Everything that a report needs, recorded during the run. Times are int ns."""

    estimate: Track = field(default_factory=Track)
    truth: Track = field(default_factory=Track)
    past_errors: ErrorSums = ErrorSums()  # of the true poses that are not among the newest
    driven_m: float = 0.0
    """Distance truly driven [m], without steps in which the robot was carried."""
    last_true: Position | None = None
    objects: dict[int, ObjectRecord] = field(default_factory=dict)
    missions: dict[int, MissionRecord] = field(default_factory=dict)
    earlier_missions: dict[str, int] = field(default_factory=dict)  # by state
    collisions: list[CollisionRecord] = field(default_factory=list)
    ports: dict[str, PortCounters] = field(default_factory=dict)
    omitted: dict[str, int] = field(default_factory=dict)
    begin: int | None = None
    end: int | None = None
    began_s: float | None = None  # by the computer's monotonic clock
    first_pose: int | None = None
    map_stamp: int | None = None

    def record_start(self, monotonic_s: float, stamp: int) -> None:
        """Record the start of the run, by the computer's monotonic clock [s] and by the robot's."""
        self.began_s = monotonic_s
        self._at(stamp)

    def record_end(self, stamp: int) -> None:
        """Record the end of the run."""
        self._at(stamp)

    def record_estimate(self, stamp: int, x: float, y: float, yaw: float) -> None:
        """Record an estimated pose [m, m, rad]."""
        self._at(stamp)
        self.first_pose = stamp if self.first_pose is None else self.first_pose
        self.estimate.add(stamp, (x, y, yaw))
        self._thin_tracks()

    def record_truth(self, stamp: int, x: float, y: float, yaw: float) -> None:
        """Record a true pose [m, m, rad]."""
        self._at(stamp)
        step = 0.0 if self.last_true is None else math.dist(self.last_true, (x, y))
        self.driven_m += step if step < _CARRIED_M else 0.0
        self.last_true = (x, y)
        self.truth.add(stamp, (x, y, yaw))
        self._thin_tracks()

    def record_true_position(self, object_id: int, x: float, y: float) -> None:
        """Record the true position of an object [m]."""
        self.object(object_id).true_position = (x, y)

    def record_map(
        self, stamp: int, objects: list[tuple[int, str, float, float, str, float]]
    ) -> None:
        """Record a visual map: id, name, position [m], state and reliability of each object.

        A map older than the last one was recorded by an earlier process of the report, and is
        ignored.
        """
        if self.map_stamp is not None and stamp < self.map_stamp:
            return
        first = self.map_stamp is None
        self.map_stamp = stamp
        most = MOST_RELIABILITIES // max(100, len(self.objects))
        for object_id, name, x, y, state, reliability in objects:
            record = self.object(object_id)
            position = _position(x, y)
            if first:
                record.map_position = position
            record.name, record.position, record.state = _cut(name), position, state
            record.add_reliability(stamp, reliability, most)

    def record_removal(self, stamp: int, object_id: int, x: float, y: float) -> None:
        """Record that an object was removed from its position [m] in the map."""
        self.object(object_id).moves.removed(stamp, _position(x, y))

    def record_registration(self, stamp: int, object_id: int) -> None:
        """Record that an object was registered at a new position."""
        self.object(object_id).moves.registered(stamp)

    def record_restoration(self, object_id: int, x: float, y: float) -> None:
        """Record that an object never left a position [m]; NaN: that it has no position."""
        self.object(object_id).moves.restored(_position(x, y))

    def record_mission(self, mission_id: int, goals: list[tuple[float, float, float]]) -> None:
        """Record a mission and its goals (x, y [m], heading [rad])."""
        mission = self._mission(mission_id)
        mission.goals = [(x, y, theta) for x, y, theta in goals[:MOST_GOALS]]
        while sum(len(one.goals) for one in self.missions.values()) > MOST_GOALS:
            self._summarize_oldest_mission()

    def record_progress(
        self,
        mission_id: int,
        state: str,
        reached: int,
        reason: str,
        seconds: float,
        recoveries: int,
    ) -> None:
        """Record the progress of a mission: state, goals reached, reason, time [s], recoveries."""
        mission = self._mission(mission_id)
        mission.state, mission.reached, mission.reason = state, reached, _cut(reason)
        mission.seconds, mission.recoveries = seconds, recoveries

    def record_collision(self, stamp: int, obstacle: str, x: float, y: float, speed: float) -> None:
        """Record a collision [m, m/s]."""
        self.collisions.append(CollisionRecord(stamp, _cut(obstacle), x, y, speed))
        if len(self.collisions) > MOST_COLLISIONS:
            del self.collisions[0]
            self._omit("collisions")

    def record_omission(self, kind: str) -> None:
        """Record that something is not in the report."""
        self._omit(_cut(kind))

    def record_port_counters(self, port: str, restarts: int, dropped: int, invalid: int) -> None:
        """Record the counters of a port (`localizer.odom`) of one process of its component."""
        counters = self.ports.get(port)
        if counters is not None:
            counters.update(restarts, (dropped, invalid))
        elif len(self.ports) < MOST_PORTS:
            self.ports[_cut(port)] = PortCounters(restarts, (dropped, invalid))
        else:
            self._omit("messages about further ports")

    def port_counters(self, port: str, restarts: int) -> tuple[int, int] | None:
        """Return the counters recorded last of this process, None if there are none."""
        counters = self.ports.get(port)
        return counters.newest if counters and counters.restarts == restarts else None

    def object(self, object_id: int) -> ObjectRecord:
        """Return the record of an object, created on first use.

        Beyond `MOST_OBJECTS`, return one that is not kept.
        """
        known = self.objects.get(object_id)
        if known is None:
            known = ObjectRecord(object_id)
            if len(self.objects) < MOST_OBJECTS:
                self.objects[object_id] = known
            else:
                self._omit("messages about further objects")
        return known

    def errors(self) -> ErrorSums:
        """Return the errors of the estimate at the times of the truth."""
        return self.past_errors.plus(self._error(None))

    def seconds(self, stamp: int | None) -> float | None:
        """Return a time as seconds from the start of the run."""
        if stamp is None or self.begin is None:
            return None
        return round((stamp - self.begin) * _NS, 3)

    def summary(self, monotonic_s: float | None) -> dict[str, Any]:
        """Return the report as plain values, ready for JSON, with the time that the run took.

        `monotonic_s` is the time now [s], None in lockstep, so that the same seed gives the same
        report byte for byte.
        """
        began_s = self.began_s
        wall_s = None if monotonic_s is None or began_s is None else monotonic_s - began_s
        error = self.errors()
        recorded = self.seconds(self.end) or 0.0
        return {
            "position_rmse_m": _rounded(error.position_rmse),
            "heading_rmse_rad": _rounded(error.heading_rmse),
            "position_error_max_m": _rounded(error.position_max),
            "first_pose_s": self.seconds(self.first_pose),
            "recorded_s": recorded,
            "dropped": self._totals(0),
            "invalid": self._totals(1),
            "objects": [self._object_summary(record) for _, record in sorted(self.objects.items())],
            "wall_s": _rounded(wall_s),
            "driven_m": _rounded(self.driven_m),
            "missions": [mission.summary() for _, mission in sorted(self.missions.items())],
            "earlier_missions": self.earlier_missions,
            "collisions": [
                {
                    "at_s": self.seconds(collision.stamp),
                    "with": collision.obstacle,
                    "x": _rounded(collision.x),
                    "y": _rounded(collision.y),
                    "speed": _rounded(collision.speed),
                }
                for collision in self.collisions
            ],
            "omitted": self.omitted,
        }

    def _error(self, until: int | None) -> TrackError:
        """Return the errors at the newest true poses, those up to a time [ns] if it is given."""
        stamps, truth = self.truth.sorted()
        if until is not None:
            stamps, truth = stamps[stamps <= until], truth[stamps <= until]
        return track_error(*self.estimate.sorted(), stamps, truth, _LONGEST_GAP_NS)

    def _thin_tracks(self) -> None:
        longest = max(self.estimate, self.truth, key=len)
        if len(longest) < MOST_RECENT:
            return
        until = sorted(longest.stamps)[len(longest) // 2]
        self.past_errors = self.past_errors.plus(self._error(until))
        self.truth.thin(until)
        self.estimate.thin(until - _LONGEST_GAP_NS)  # the next true poses are interpolated from it
        if len(self.estimate) >= MOST_RECENT:  # too many within that time
            self.estimate.thin(until)

    def _mission(self, mission_id: int) -> MissionRecord:
        mission = self.missions.setdefault(mission_id, MissionRecord(mission_id))
        if len(self.missions) > MOST_MISSIONS:
            self._summarize_oldest_mission()
        return mission

    def _summarize_oldest_mission(self) -> None:
        state = self.missions.pop(next(iter(self.missions))).state
        self.earlier_missions[state] = self.earlier_missions.get(state, 0) + 1

    def _omit(self, kind: str) -> None:
        if kind in self.omitted or len(self.omitted) < MOST_PORTS:
            self.omitted[kind] = self.omitted.get(kind, 0) + 1

    def _at(self, stamp: int) -> None:
        self.begin = stamp if self.begin is None else min(self.begin, stamp)
        self.end = stamp if self.end is None else max(self.end, stamp)

    def _totals(self, which: int) -> dict[str, int]:
        """Return one of the counters of each port."""
        return {port: counters.total(which) for port, counters in sorted(self.ports.items())}

    def _object_summary(self, record: ObjectRecord) -> dict[str, Any]:
        x, y = record.position or (None, None)
        true_x, true_y = record.true_position or (None, None)
        map_x, map_y = record.map_position or (None, None)
        return {
            "id": record.object_id,
            "name": record.name,
            "x": _rounded(x),
            "y": _rounded(y),
            "true_x": _rounded(true_x),
            "true_y": _rounded(true_y),
            "map_x": _rounded(map_x),
            "map_y": _rounded(map_y),
            "reliability": _rounded(record.reliability),
            "state": record.state,
            "removed_at_s": self.seconds(record.moves.last.removed_at),
            "registered_at_s": self.seconds(record.moves.last.registered_at),
        }


def _position(x: float, y: float) -> tuple[float, float] | None:
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


def _cut(text: str) -> str:
    return text[:_LONGEST_TEXT]


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 6)


@dataclass
class MissionRecord:
    """One mission: its goals (x, y [m], heading [rad]), how many were reached, and its result."""

    mission_id: int
    goals: list[Pose] = field(default_factory=list)
    reached: int = 0
    state: str = "sent"
    reason: str = ""
    seconds: float = 0.0
    recoveries: int = 0

    def summary(self) -> dict[str, Any]:
        """Return it as plain values."""
        goals = [list(goal) for goal in self.goals]
        return vars(self) | {"goals": goals, "seconds": round(self.seconds, 3)}


@dataclass(frozen=True)
class CollisionRecord:
    """A collision: when [ns], with which obstacle, where [m], how fast [m/s]."""

    stamp: int
    obstacle: str
    x: float
    y: float
    speed: float


@dataclass(frozen=True)
class TrackError:
    """Errors of an estimated track at the times of the true one.

    `stamps` int64[N] ns; `position` float64[N] m; `heading` float64[N] rad, wrapped to +-pi.
    """

    stamps: NDArray[np.int64]
    position: NDArray[np.float64]
    heading: NDArray[np.float64]


def track_error(
    estimate_stamps: NDArray[np.int64],
    estimate: NDArray[np.float64],
    truth_stamps: NDArray[np.int64],
    truth: NDArray[np.float64],
    longest_gap_ns: int,
) -> TrackError:
    """Compare an estimated track (N x 3: x, y m, heading rad) with the true one (M x 3).

    The estimate is interpolated at the time of each true pose within it; true poses in a gap of the
    estimate longer than `longest_gap_ns` are compared with the last estimate before, because that
    is what the robot believed. Stamps must not decrease.
    """
    if len(estimate) == 0 or len(truth) == 0:
        empty = np.empty(0)
        return TrackError(np.empty(0, np.int64), empty, empty)
    inside = (truth_stamps >= estimate_stamps[0]) & (truth_stamps <= estimate_stamps[-1])
    stamps = truth_stamps[inside]
    true = truth[inside]
    after = np.clip(np.searchsorted(estimate_stamps, stamps), 1, max(1, len(estimate) - 1))
    if len(estimate) == 1:
        after = np.zeros(len(stamps), np.intp)
    before = np.maximum(after - 1, 0)
    gap = estimate_stamps[after] - estimate_stamps[before]
    safe = np.where(gap > 0, gap, 1)
    share = np.where(
        (gap > 0) & (gap <= longest_gap_ns), (stamps - estimate_stamps[before]) / safe, 0.0
    )
    share = np.where((gap > longest_gap_ns) & (stamps >= estimate_stamps[after]), 1.0, share)
    step = estimate[after] - estimate[before]
    step[:, 2] = wrap_all(step[:, 2])
    interpolated = estimate[before] + share[:, None] * step
    difference = interpolated - true
    return TrackError(
        stamps, np.hypot(difference[:, 0], difference[:, 1]), wrap_all(difference[:, 2])
    )
