"""Landmarks of the map: what observations of objects add to the pose graph, and the result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.odometry_log import OdometryPath
from cairn.components.slam.pose_graph import AGREES, PoseGraph, Sighting, relative_all
from cairn.planar.poses import wrap_all
from cairn.visual_map.landmarks import INITIAL_RELIABILITY, LandmarkRecord, MapPosition
from cairn.visual_map.new_map import write_map
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]

# A landmark is certain with so many sightings that agree, if those are half of all.
_LEAST_SIGHTINGS = 3
# Errors of observations from different keyframes repeat, too, as those of ranges and of the
# camera's direction do: so much of their information counts in the covariance of a landmark, as in
# the localizer (`independence`). On MRCLAM data set 6 the mean normalized error squared is 1.1 and
# 2.0 with it, 7.6 and 13.5 without; 2 is right.
_INDEPENDENCE = 0.15
# Most moves of one object, and times at which one is tried.
_MOST_MOVES, _MOST_TIMES = 4, 60
# The landmark of an object has the number of the object; after each move this more.
_NEXT_PLACE = 2**32


@dataclass(frozen=True)
class MappedLandmark:
    """A landmark of the map.

    Attributes:
        object_id: number of the object.
        position: in the map, with its covariance relative to the map as a whole.
        sightings: number of keyframes from which it was observed there.

    """

    object_id: int
    position: MapPosition
    sightings: int


@dataclass(frozen=True)
class MovedObject:
    """An object that stood in two places: positions [m]."""

    object_id: int
    old: tuple[float, float]
    new: tuple[float, float]


@dataclass(frozen=True)
class LandmarkReport:
    """What became of the observations.

    Attributes:
        landmarks: those that are certain, by object id.
        moved: objects that were moved while the map was made; `landmarks` has the last position.
        uncertain: ids of objects that were seen too rarely, or in too many places.
        sightings: number of sightings: observations from one keyframe count as one.
        outliers: how many of them contradict their landmark.
        ambiguous: number of observations of objects that look like others, and could be several.

    """

    landmarks: tuple[MappedLandmark, ...]
    moved: tuple[MovedObject, ...]
    uncertain: tuple[int, ...]
    sightings: int
    outliers: int
    ambiguous: int


@dataclass(frozen=True)
class _Seen:
    """An observation made at `stamp_ns`, with the keyframe that it belongs to."""

    keyframe: int
    stamp_ns: int
    observation: Observation


class LandmarkBuilder:
    """Turns observations of objects into sightings of the pose graph.

    Successive images show an object with nearly the same error. So the observations of an object
    that belong to one keyframe are one sighting: their median, no more certain than one of them.
    """

    def __init__(self, graph: PoseGraph) -> None:
        """Start with a graph without sightings."""
        self._graph = graph
        self._rows: dict[tuple[int, int], int] = {}  # of sightings, by keyframe and object
        self._seen: list[list[_Seen]] = []  # of sightings from row `_first` on
        self._first = 0
        self._ambiguous: list[_Seen] = []
        self._newest: dict[int, int] = {}  # landmark of each object

    def resume(self) -> None:
        """Continue with sightings that were read from a file; they stay as they are."""
        self._first = len(self._graph.sightings)
        self._rows, self._seen, self._ambiguous, self._newest = {}, [], [], {}
        for landmark in sorted(self._graph.landmarks):
            self._newest[landmark % _NEXT_PLACE] = landmark

    def add(
        self, keyframe: int, stamp_ns: int, observation: Observation, path: OdometryPath, at_ns: int
    ) -> bool:
        """Add an observation made at `stamp_ns` to a keyframe at `at_ns` [ns].

        Return whether it contradicts the graph, so that it may close a loop. An object that looks
        like others waits for `resolve`.
        """
        one = _Seen(keyframe, stamp_ns, observation)
        if observation.alternatives:
            self._ambiguous.append(one)
            return False
        return self._set(self._add(one), path, at_ns)

    def resolve(self, path: OdometryPath, stamps: NDArray[np.int64]) -> None:
        """Assign observations of objects that look like others where only one landmark fits.

        `stamps` (n,) are the times of the keyframes [ns].
        """
        waiting: list[_Seen] = []
        for one in self._ambiguous:
            candidates = {one.observation.object_id, *one.observation.alternatives}
            at_ns = int(stamps[one.keyframe])
            measured = _merged([[one]], path, [at_ns])[0].tolist()
            known = [k for k in self._newest if k in candidates]
            sightings = [Sighting(one.keyframe, self._newest[k], *measured) for k in known]
            deviations = self._graph.sighting_deviations(sightings).tolist()
            near = sorted(zip(deviations, known, strict=True))
            if not near or near[0][0] > AGREES or (near[1:2] and near[1][0] < 2 * AGREES):
                waiting.append(one)
                continue
            sure = replace(one.observation, object_id=near[0][1], alternatives=())
            self._set(self._add(replace(one, observation=sure)), path, at_ns)
        self._ambiguous = waiting

    def measured(self, path: OdometryPath, stamps: NDArray[np.int64]) -> Array:
        """Return range [m] and bearing [rad] (n, 2) of all sightings with another odometry.

        `stamps` are the times of the keyframes [ns].
        """
        old = [(s.range_m, s.bearing) for s in self._graph.sightings[: self._first]]
        return np.vstack((np.array(old).reshape(-1, 2), self._merged(path, stamps)[:, :2]))

    def rebuild(self, path: OdometryPath, stamps: NDArray[np.int64]) -> None:
        """Replace all sightings of the graph by those with another odometry."""
        for row, measured in enumerate(self._merged(path, stamps).tolist(), self._first):
            old = self._graph.sightings[row]
            self._graph.sightings[row] = Sighting(old.keyframe, old.landmark, *measured)

    def split_moved(self) -> bool:
        """Make two landmarks of the object that was most clearly moved; return whether one was.

        The graph has been optimized, with the object in one place, and has to be optimized again.
        """
        best: tuple[_Move, int, list[int]] | None = None
        points = self._graph.sighted_points()
        for object_id, landmark in sorted(self._newest.items()):
            if landmark // _NEXT_PLACE == _MOST_MOVES:
                continue
            rows = self._rows_of(landmark)
            found = _find_move(points[rows], self._spreads(rows))
            if found is not None and (best is None or found.gain > best[0].gain):
                best = found, object_id, rows
        if best is None:
            return False
        move, object_id, rows = best
        self._graph.landmarks[self._newest[object_id]] = move.old
        self._newest[object_id] += _NEXT_PLACE
        self._graph.landmarks[self._newest[object_id]] = move.new
        self._assign(rows[move.split :], self._newest[object_id])
        return True

    def join_places(self) -> bool:
        """Make one landmark of successive places of an object that are the same after all.

        While other objects are not split yet, the map is bent, and an object may seem to move.
        Return whether the graph has to be optimized again.
        """
        joined = False
        points = self._graph.sighted_points()
        for object_id, newest in self._newest.items():
            before = object_id
            for landmark in range(object_id + _NEXT_PLACE, newest + 1, _NEXT_PLACE):
                if landmark not in self._graph.landmarks:
                    continue
                old, new = self._rows_of(before), self._rows_of(landmark)
                both = old + new
                if _move_at(len(old), points[both], self._spreads(both)).is_clear:
                    before = landmark
                    continue
                self._assign(new, before)
                del self._graph.landmarks[landmark]
                joined = True
            self._newest[object_id] = before
        return joined

    def report(self) -> LandmarkReport:
        """Return the landmarks of the finished graph; `stamps` are the times of keyframes [ns]."""
        graph = self._graph
        deviations = graph.sighting_deviations(graph.sightings)
        covariances = graph.landmark_covariances() if graph.sightings else {}
        certain, uncertain = [], []
        for object_id, landmark in sorted(self._newest.items()):
            rows = self._rows_of(landmark)
            agreeing = [row for row in rows if deviations[row] < AGREES]
            if len(agreeing) < max(_LEAST_SIGHTINGS, 0.5 * len(rows)):
                uncertain.append(object_id)
                continue
            (x, y), covariance = graph.landmarks[landmark], covariances[landmark] / _INDEPENDENCE
            xx, xy, _, yy = covariance.ravel().tolist()
            position = MapPosition(x, y, xx, xy, yy)
            certain.append(MappedLandmark(object_id, position, len(agreeing)))
        return LandmarkReport(
            landmarks=tuple(certain),
            moved=tuple(self._moves()),
            uncertain=tuple(uncertain),
            sightings=len(graph.sightings),
            outliers=int((deviations > AGREES).sum()),
            ambiguous=len(self._ambiguous),
        )

    def _add(self, one: _Seen) -> int:
        """Add an observation to the sighting from its keyframe; return the row of that."""
        key = (one.keyframe, one.observation.object_id)
        row = self._rows.setdefault(key, self._first + len(self._seen))
        if row == self._first + len(self._seen):
            self._seen.append([])
        self._seen[row - self._first].append(one)
        return row

    def _set(self, row: int, path: OdometryPath, at_ns: int) -> bool:
        """Set a sighting of the graph; return whether it contradicts the graph."""
        group = self._seen[row - self._first]
        object_id = group[0].observation.object_id
        landmark = self._newest.setdefault(object_id, object_id)
        measured = _merged([group], path, [at_ns])[0].tolist()
        sighting = Sighting(group[0].keyframe, landmark, *measured)
        if row < len(self._graph.sightings):
            self._graph.sightings[row] = sighting
        else:
            self._graph.add_sighting(sighting)
        return bool(self._graph.sighting_deviations([sighting])[0] > AGREES)

    def _merged(self, path: OdometryPath, stamps: NDArray[np.int64]) -> Array:
        at = [int(stamps[group[0].keyframe]) for group in self._seen]
        return _merged(self._seen, path, at)

    def _moves(self) -> Iterator[MovedObject]:
        places = self._graph.landmarks
        for landmark in sorted(places):
            object_id = landmark % _NEXT_PLACE
            later = [k for k in places if k % _NEXT_PLACE == object_id and k > landmark]
            if later:
                yield MovedObject(object_id, places[landmark], places[min(later)])

    def _assign(self, rows: list[int], landmark: int) -> None:
        for row in rows:
            sighting = replace(self._graph.sightings[row], landmark=landmark)
            self._graph.sightings[row] = sighting

    def _rows_of(self, landmark: int) -> list[int]:
        sightings = self._graph.sightings
        rows = [row for row, s in enumerate(sightings) if s.landmark == landmark]
        return sorted(rows, key=lambda row: sightings[row].keyframe)

    def _spreads(self, rows: list[int]) -> Array:
        """Return the standard deviation [m] of where each sighting puts its landmark."""
        chosen = [self._graph.sightings[row] for row in rows]
        return np.array([math.hypot(s.range_sd, s.range_m * s.bearing_sd) for s in chosen])


def write_landmarks(
    path: Path,
    source: str,
    landmarks: Sequence[MappedLandmark],
    created_s: float | None = None,
) -> None:
    """Write a new visual map of landmarks, each with neutral reliability.

    `created_s` is the time of creation in the file [s since 1970], None: the system's.
    """
    write_map(
        path,
        source,
        [
            LandmarkRecord(
                one.object_id, f"object {one.object_id}", one.position, INITIAL_RELIABILITY
            )
            for one in landmarks
        ],
        created_s=created_s,
    )


def _merged(groups: Sequence[Sequence[_Seen]], path: OdometryPath, at_ns: Sequence[int]) -> Array:
    """Return each group of observations of one object from one keyframe as one: the medians.

    Args:
        groups: n groups.
        path: of odometry.
        at_ns: time of the keyframe of each group [ns].

    Returns:
        Range [m], bearing [rad] from the keyframe, and their standard deviations (n, 4).

    """
    every = [one for group in groups for one in group]
    counts = np.array([len(group) for group in groups], np.int64)
    group_of = np.repeat(np.arange(len(groups)), counts)
    columns = [
        (o.range_m, o.bearing, o.range_variance, o.bearing_variance)
        for o in (one.observation for one in every)
    ]
    ranges, bearings, range_variances, bearing_variances = np.array(columns).reshape(-1, 4).T
    made = path.at(np.array([one.stamp_ns for one in every], np.int64))
    offsets = relative_all(path.at(np.array(at_ns, np.int64))[group_of], made)
    x = offsets[:, 0] + ranges * np.cos(offsets[:, 2] + bearings)
    y = offsets[:, 1] + ranges * np.sin(offsets[:, 2] + bearings)
    directions = np.arctan2(y, x)
    first = directions[np.cumsum(counts) - counts]
    middle = _medians(wrap_all(directions - first[group_of]), group_of, counts)
    return np.column_stack(
        (
            _medians(np.hypot(x, y), group_of, counts),
            wrap_all(first + middle),
            np.sqrt(_medians(range_variances, group_of, counts)),
            np.sqrt(_medians(bearing_variances, group_of, counts)),
        )
    )


def _medians(values: Array, group_of: NDArray[np.int64], counts: NDArray[np.int64]) -> Array:
    """Return the median of each group (n,); `group_of` (m,) increases."""
    ordered = values[np.lexsort((values, group_of))]
    first = np.cumsum(counts) - counts
    medians: Array = 0.5 * (ordered[first + (counts - 1) // 2] + ordered[first + counts // 2])
    return medians


@dataclass(frozen=True)
class _Move:
    """A move of an object before its sighting `split`.

    `gain` is by how much two places decrease the sum of squared errors of its `sightings`.
    """

    split: int
    old: tuple[float, float]
    new: tuple[float, float]
    gain: float
    sightings: int

    @property
    def is_clear(self) -> bool:
        """Whether the object was moved, by the Bayesian information criterion.

        The second place and the time of the move are three parameters more.
        """
        return _INDEPENDENCE * self.gain > 3 * math.log(self.sightings)


def _find_move(points: Array, spreads: Array) -> _Move | None:
    """Return the move that explains the sightings of an object best; None if it stood still.

    Args:
        points: where its sightings (n, 2) put it [m], in the order of time.
        spreads: standard deviations (n,) of them [m].

    """
    stride = max(1, len(points) // _MOST_TIMES)
    splits = range(_LEAST_SIGHTINGS, len(points) - _LEAST_SIGHTINGS + 1, stride)
    moves = [_move_at(split, points, spreads) for split in splits]
    return max((move for move in moves if move.is_clear), key=lambda one: one.gain, default=None)


def _move_at(split: int, points: Array, spreads: Array) -> _Move:
    def place(some: slice) -> tuple[float, tuple[float, float]]:
        x, y = np.median(points[some], axis=0).tolist()
        deviations = np.hypot(*(points[some] - (x, y)).T) / spreads[some]
        return float((np.minimum(deviations, AGREES) ** 2).sum()), (x, y)

    in_one_place, _ = place(slice(None))
    before, old = place(slice(split))
    after, new = place(slice(split, None))
    gain = in_one_place - before - after
    return _Move(split, old, new, gain, len(points))
