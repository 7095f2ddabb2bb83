"""The record of a run: tracks, objects and their moves, missions; and its journal on disk."""

from __future__ import annotations

import json
import logging
import math
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import wrap_all

# A gap of the estimate longer than this is not interpolated [ns].
_LONGEST_GAP_NS = 1_000_000_000
_NS = 1e-9
# A longer step of the truth is not driven: the robot was carried [m].
_CARRIED_M = 0.5


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
        self.standing.append(ObjectMove(left, stamp))

    def registered(self, stamp: int) -> None:
        """Add that the object was registered at a new position."""
        if not self.standing or self.standing[-1].registered_at is not None:
            self.standing.append(ObjectMove(None, None))
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


@dataclass
class RunRecord:
    """Everything that a report needs, recorded during the run. Times are int ns."""

    estimate_stamps: list[int] = field(default_factory=list)
    estimate: list[tuple[float, float, float]] = field(default_factory=list)
    truth_stamps: list[int] = field(default_factory=list)
    truth: list[tuple[float, float, float]] = field(default_factory=list)
    objects: dict[int, ObjectRecord] = field(default_factory=dict)
    missions: dict[int, MissionRecord] = field(default_factory=dict)
    collisions: list[CollisionRecord] = field(default_factory=list)
    # Messages dropped and rejected by each port, by the number of restarts of its component.
    counts: dict[tuple[str, int], tuple[int, int]] = field(default_factory=dict)
    begin: int | None = None
    end: int | None = None
    began_s: float | None = None  # by the computer's monotonic clock
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
        self.estimate_stamps.append(stamp)
        self.estimate.append((x, y, yaw))

    def record_truth(self, stamp: int, x: float, y: float, yaw: float) -> None:
        """Record a true pose [m, m, rad]."""
        self._at(stamp)
        self.truth_stamps.append(stamp)
        self.truth.append((x, y, yaw))

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
        for object_id, name, x, y, state, reliability in objects:
            record = self.object(object_id)
            position = _position(x, y)
            if first:
                record.map_position = position
            record.name, record.position, record.state = name, position, state
            record.reliability = reliability
            record.history.append((stamp, reliability))

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
        mission = self.missions.setdefault(mission_id, MissionRecord(mission_id))
        mission.goals = [(x, y, theta) for x, y, theta in goals]

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
        mission = self.missions.setdefault(mission_id, MissionRecord(mission_id))
        mission.state, mission.reached, mission.reason = state, reached, reason
        mission.seconds, mission.recoveries = seconds, recoveries

    def record_collision(self, stamp: int, obstacle: str, x: float, y: float, speed: float) -> None:
        """Record a collision [m, m/s]."""
        self.collisions.append(CollisionRecord(stamp, obstacle, x, y, speed))

    def driven_m(self) -> float:
        """Return the distance truly driven [m], without steps in which the robot was carried."""
        steps = np.hypot(*np.diff(self.true_track()[:, :2], axis=0).T)
        return float(steps[steps < _CARRIED_M].sum())

    def record_port_counters(
        self, port: str, process_number: int, dropped: int, invalid: int
    ) -> None:
        """Record the counters of a port (`localizer.odom`) of one process of its component."""
        self.counts[port, process_number] = (dropped, invalid)

    def port_counters(self, port: str, process_number: int) -> tuple[int, int] | None:
        """Return the counters recorded last, None before the first."""
        return self.counts.get((port, process_number))

    def object(self, object_id: int) -> ObjectRecord:
        """Return the record of an object, created on first use."""
        return self.objects.setdefault(object_id, ObjectRecord(object_id))

    def track(self) -> NDArray[np.float64]:
        """Return the estimated track, N x 3 (m, m, rad)."""
        return np.array(self.estimate, dtype=np.float64).reshape(-1, 3)

    def true_track(self) -> NDArray[np.float64]:
        """Return the true track, N x 3 (m, m, rad)."""
        return np.array(self.truth, dtype=np.float64).reshape(-1, 3)

    def error(self) -> TrackError:
        """Return the error of the estimate at the times of the truth."""
        estimate_stamps = np.array(self.estimate_stamps, dtype=np.int64)
        order = np.argsort(estimate_stamps, kind="stable")
        return track_error(
            estimate_stamps[order],
            self.track()[order],
            np.array(self.truth_stamps, dtype=np.int64),
            self.true_track(),
            _LONGEST_GAP_NS,
        )

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
        error = self.error()
        recorded = self.seconds(self.end) or 0.0
        return {
            "position_rmse_m": _rounded(error.position_rmse),
            "heading_rmse_rad": _rounded(error.heading_rmse),
            "position_error_max_m": _rounded(
                float(error.position.max()) if len(error.position) else None
            ),
            "first_pose_s": self.seconds(self.estimate_stamps[0] if self.estimate_stamps else None),
            "recorded_s": recorded,
            "dropped": self._totals(0),
            "invalid": self._totals(1),
            "objects": [self._object_summary(record) for _, record in sorted(self.objects.items())],
            "wall_s": _rounded(wall_s),
            "driven_m": _rounded(self.driven_m()),
            "missions": [mission.summary() for _, mission in sorted(self.missions.items())],
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
        }

    def _at(self, stamp: int) -> None:
        self.begin = stamp if self.begin is None else min(self.begin, stamp)
        self.end = stamp if self.end is None else max(self.end, stamp)

    def _totals(self, which: int) -> dict[str, int]:
        """Return one of the counters of each port, summed over all processes of its component."""
        totals: dict[str, int] = {}
        for (port, _), counts in sorted(self.counts.items()):
            totals[port] = totals.get(port, 0) + counts[which]
        return totals

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


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 6)


Goal = tuple[float, float, float]


@dataclass
class MissionRecord:
    """One mission: its goals (x, y [m], heading [rad]), how many were reached, and its result."""

    mission_id: int
    goals: list[Goal] = field(default_factory=list)
    reached: int = 0
    state: str = "sent"
    reason: str = ""
    seconds: float = 0.0
    recoveries: int = 0

    def summary(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "mission_id": self.mission_id,
            "goals": [list(goal) for goal in self.goals],
            "reached": self.reached,
            "state": self.state,
            "reason": self.reason,
            "seconds": round(self.seconds, 3),
            "recoveries": self.recoveries,
        }


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

    @property
    def position_rmse(self) -> float | None:
        """Root mean square of the position error [m]; None without a common time."""
        return _rms(self.position)

    @property
    def heading_rmse(self) -> float | None:
        """Root mean square of the heading error [rad]; None without a common time."""
        return _rms(self.heading)


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


def _rms(values: NDArray[np.float64]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


Value = int | float | str | None | list["Value"]


class RunJournal:
    """Records through a record's methods, and writes a line of JSON for each call.

    Each line is handed to the system at once: what was recorded survives SIGKILL.
    """

    def __init__(self, record: RunRecord, file: Path, log: logging.Logger, *, resume: bool) -> None:
        """Open the file; with `resume`, first replay what it holds into the record.

        Raises `OSError` if the file cannot be opened.
        """
        self._record = record
        self._file = file
        self._log = log
        if resume and file.exists():
            self._replay()
        self._stream: IO[str] | None = file.open("a" if resume else "w", buffering=1)
        if resume:
            self._write("\n")  # the last line may have been cut off

    def write(self, method: str, *values: Value) -> None:
        """Call a method of the record, and write the call to the file."""
        getattr(self._record, method)(*values)
        self._write(json.dumps([method, *values]) + "\n")

    def remove(self) -> None:
        """Close and remove the file, as the report is written."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None
        self._file.unlink(missing_ok=True)

    def _replay(self) -> None:
        for line in self._file.read_text(encoding="utf-8").splitlines():
            try:
                method, *values = json.loads(line)
            except ValueError:  # cut off by the end of the process
                continue
            getattr(self._record, method)(*values)

    def _write(self, text: str) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write(text)
        except OSError as error:  # the record goes on, and so does the robot
            self._log.warning(
                "%s cannot be written (%s): should this process be killed, the report is lost",
                self._file, error.strerror,
            )  # fmt: skip
            with suppress(OSError):  # again, for the line that it still holds
                self._stream.close()
            self._stream = None
