"""What is kept of a run for its report: tracks, the map's objects and their history."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cairn.components.report.moves import Moves
from cairn.components.report.orders import OrderRecord, Touch
from cairn.components.report.track import TrackError, track_error

_LONGEST_GAP_NS = 1_000_000_000
_NS = 1e-9
_CARRIED_M = 0.5


@dataclass
class ObjectRecord:
    """One object of the visual map: where the map first had it, where it is, what happened."""

    object_id: int
    name: str = ""
    map_place: tuple[float, float] | None = None
    place: tuple[float, float] | None = None
    true_place: tuple[float, float] | None = None
    reliability: float = 0.5
    state: str = "unknown"
    moves: Moves = field(default_factory=Moves)
    history: list[tuple[int, float]] = field(default_factory=list)


@dataclass
class RunRecord:
    """Everything that a report needs, filled while the run goes on. Times are int ns."""

    estimate_stamps: list[int] = field(default_factory=list)
    estimate: list[tuple[float, float, float]] = field(default_factory=list)
    truth_stamps: list[int] = field(default_factory=list)
    truth: list[tuple[float, float, float]] = field(default_factory=list)
    objects: dict[int, ObjectRecord] = field(default_factory=dict)
    orders: dict[int, OrderRecord] = field(default_factory=dict)
    collisions: list[Touch] = field(default_factory=list)
    # Messages dropped and refused by each port of each incarnation of a component.
    counts: dict[tuple[str, int], tuple[int, int]] = field(default_factory=dict)
    begin: int | None = None
    end: int | None = None
    began_s: float | None = None  # by the computer's monotonic clock
    map_stamp: int | None = None

    def begins(self, monotonic_s: float, stamp: int) -> None:
        """Note when the run began, by the computer's monotonic clock [s] and by the robot's."""
        self.began_s = monotonic_s
        self._at(stamp)

    def ends(self, stamp: int) -> None:
        """Note when the run ended."""
        self._at(stamp)

    def estimated(self, stamp: int, x: float, y: float, yaw: float) -> None:
        """Keep an estimated pose [m, m, rad]."""
        self._at(stamp)
        self.estimate_stamps.append(stamp)
        self.estimate.append((x, y, yaw))

    def was_truly_at(self, stamp: int, x: float, y: float, yaw: float) -> None:
        """Keep a true pose [m, m, rad]."""
        self._at(stamp)
        self.truth_stamps.append(stamp)
        self.truth.append((x, y, yaw))

    def stands_truly_at(self, object_id: int, x: float, y: float) -> None:
        """Keep the true place of an object [m]."""
        self.object(object_id).true_place = (x, y)

    def mapped(self, stamp: int, objects: list[tuple[int, str, float, float, str, float]]) -> None:
        """Keep a visual map: id, name, place [m], state and reliability of each object.

        Maps older than the last one have come before, to a former incarnation of the report.
        """
        if self.map_stamp is not None and stamp < self.map_stamp:
            return
        first = self.map_stamp is None
        self.map_stamp = stamp
        for object_id, name, x, y, state, reliability in objects:
            record = self.object(object_id)
            place = _place(x, y)
            if first:
                record.map_place = place
            record.name, record.place, record.state = name, place, state
            record.reliability = reliability
            record.history.append((stamp, reliability))

    def was_removed(self, stamp: int, object_id: int, x: float, y: float) -> None:
        """Note that an object was removed from its place [m] in the map."""
        self.object(object_id).moves.removed(stamp, _place(x, y))

    def was_registered(self, stamp: int, object_id: int) -> None:
        """Note that an object was registered at a new place."""
        self.object(object_id).moves.registered(stamp)

    def was_restored(self, object_id: int, x: float, y: float) -> None:
        """Note that an object never left a place [m]; NaN: that it is still to be found."""
        self.object(object_id).moves.restored(_place(x, y))

    def ordered(self, mission_id: int, goals: list[tuple[float, float, float]]) -> None:
        """Note an order to move and its goals (x, y [m], heading [rad])."""
        order = self.orders.setdefault(mission_id, OrderRecord(mission_id))
        order.goals = [(x, y, theta) for x, y, theta in goals]

    def moved_on(
        self,
        mission_id: int,
        state: str,
        reached: int,
        reason: str,
        seconds: float,
        recoveries: int,
    ) -> None:
        """Note how an order gets on: state, goals reached, time taken [s]."""
        order = self.orders.setdefault(mission_id, OrderRecord(mission_id))
        order.state, order.reached, order.reason = state, reached, reason
        order.seconds, order.recoveries = seconds, recoveries

    def collided(self, stamp: int, what: str, x: float, y: float, speed: float) -> None:
        """Note a collision [m, m/s]."""
        self.collisions.append(Touch(stamp, what, x, y, speed))

    def driven_m(self) -> float:
        """The way truly driven [m]; steps of more than half a meter are not driven but carried."""
        steps = np.hypot(*np.diff(self.true_track()[:, :2], axis=0).T)
        return float(steps[steps < _CARRIED_M].sum())

    def lost(self, port: str, incarnation: int, dropped: int, invalid: int) -> None:
        """Note the counters of a port (`localizer.odom`) of an incarnation of its component."""
        self.counts[port, incarnation] = (dropped, invalid)

    def losses(self, port: str, incarnation: int) -> tuple[int, int] | None:
        """The counters last noted, None before the first."""
        return self.counts.get((port, incarnation))

    def object(self, object_id: int) -> ObjectRecord:
        """The record of an object, begun on first use."""
        return self.objects.setdefault(object_id, ObjectRecord(object_id))

    def track(self) -> NDArray[np.float64]:
        """The estimated track, N x 3 (m, m, rad)."""
        return np.array(self.estimate, dtype=np.float64).reshape(-1, 3)

    def true_track(self) -> NDArray[np.float64]:
        """The true track, N x 3 (m, m, rad)."""
        return np.array(self.truth, dtype=np.float64).reshape(-1, 3)

    def error(self) -> TrackError:
        """The estimate's error at the times of the truth."""
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
        """A time as seconds from the run's beginning."""
        if stamp is None or self.begin is None:
            return None
        return round((stamp - self.begin) * _NS, 3)

    def summary(self, monotonic_s: float | None) -> dict[str, Any]:
        """The report as plain values, ready for JSON, with the time that the run took.

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
            "objects": [self._object(record) for _, record in sorted(self.objects.items())],
            "wall_s": _rounded(wall_s),
            "driven_m": _rounded(self.driven_m()),
            "orders": [order.summary() for _, order in sorted(self.orders.items())],
            "collisions": [
                {
                    "at_s": self.seconds(touch.stamp),
                    "with": touch.what,
                    "x": _rounded(touch.x),
                    "y": _rounded(touch.y),
                    "speed": _rounded(touch.speed),
                }
                for touch in self.collisions
            ],
        }

    def _at(self, stamp: int) -> None:
        self.begin = stamp if self.begin is None else min(self.begin, stamp)
        self.end = stamp if self.end is None else max(self.end, stamp)

    def _totals(self, which: int) -> dict[str, int]:
        """One of the counters of each port, over all incarnations of its component."""
        totals: dict[str, int] = {}
        for (port, _), counts in sorted(self.counts.items()):
            totals[port] = totals.get(port, 0) + counts[which]
        return totals

    def _object(self, record: ObjectRecord) -> dict[str, Any]:
        x, y = record.place or (None, None)
        true_x, true_y = record.true_place or (None, None)
        map_x, map_y = record.map_place or (None, None)
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


def _place(x: float, y: float) -> tuple[float, float] | None:
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 6)
