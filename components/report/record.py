"""What is kept of a run for its report: tracks, the map's objects and their history."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from components.report.track import TrackError, track_error

_LONGEST_GAP_NS = 1_000_000_000
_NS = 1e-9


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
    removed_at: int | None = None
    registered_at: int | None = None
    history: list[tuple[int, float]] = field(default_factory=list)


@dataclass
class RunRecord:
    """Everything that a report needs, filled while the run goes on. Times are int ns."""

    estimate_stamps: list[int] = field(default_factory=list)
    estimate: list[tuple[float, float, float]] = field(default_factory=list)
    truth_stamps: list[int] = field(default_factory=list)
    truth: list[tuple[float, float, float]] = field(default_factory=list)
    objects: dict[int, ObjectRecord] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    invalid: dict[str, int] = field(default_factory=dict)
    begin: int | None = None
    end: int | None = None

    def at(self, stamp: int) -> None:
        """Note that the run has lived at `stamp`."""
        self.begin = stamp if self.begin is None else min(self.begin, stamp)
        self.end = stamp if self.end is None else max(self.end, stamp)

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

    def summary(self, wall_s: float | None) -> dict[str, Any]:
        """The report as plain values, ready for JSON; `wall_s` is the measured duration [s].

        It is None in lockstep, so that the same seed gives the same report byte for byte.
        """
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
            "dropped": dict(sorted(self.dropped.items())),
            "invalid": dict(sorted(self.invalid.items())),
            "objects": [self._object(record) for _, record in sorted(self.objects.items())],
            "wall_s": _rounded(wall_s),
        }

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
            "removed_at_s": self.seconds(record.removed_at),
            "registered_at_s": self.seconds(record.registered_at),
        }


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 6)
