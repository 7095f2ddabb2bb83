"""The graph file (SQLite): keyframes, submaps and constraints, from which mapping continues.

Keyframes and constraints are appended while the robot drives; poses are replaced when the graph was
optimized. A kill loses what was added since the last `save`, and never the file.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from cairn.bounded_files import too_large
from cairn.bounded_sqlite import SchemaError, bound_connection, table_columns
from cairn.components.slam.keyframes import Keyframe, ScanRays, Submap
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.point_cloud import PointCloud
from cairn.components.slam.pose_graph import Edge, EdgeKind, Sighting
from cairn.errors import CairnError
from cairn.files import explain_os_error, replacing

Array = NDArray[np.float64]

APPLICATION: Final = 0x4361_7267
"""SQLite's application id of a graph file, in the file's header: "Carg"."""

FILE_BYTES: Final = 4_000_000_000
"""Largest graph file [bytes]."""

_FORMAT: Final = 1
_TABLES: Final = {
    "graph": "farthest REAL NOT NULL, created_s REAL NOT NULL, source TEXT NOT NULL",
    "keyframes": "number INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, submap INTEGER NOT NULL, "
    "odometry BLOB NOT NULL, cloud BLOB NOT NULL, geometry BLOB, ranges BLOB",
    "poses": "number INTEGER PRIMARY KEY, x REAL NOT NULL, y REAL NOT NULL, theta REAL NOT NULL",
    "submaps": "number INTEGER PRIMARY KEY, first INTEGER NOT NULL, last INTEGER NOT NULL",
    "edges": "number INTEGER PRIMARY KEY, kind INTEGER NOT NULL, first INTEGER NOT NULL, "
    "second INTEGER NOT NULL, measured BLOB NOT NULL, information BLOB NOT NULL",
    "sightings": "number INTEGER PRIMARY KEY, keyframe INTEGER NOT NULL, "
    "landmark INTEGER NOT NULL, measured BLOB NOT NULL",
    "landmarks": "landmark INTEGER PRIMARY KEY, x REAL NOT NULL, y REAL NOT NULL",
}
_LONGEST_VALUE: Final = 2_000_000  # bytes of the points of one scan
_MOST_KEYFRAMES: Final = 500_000
_STEPS: Final = 400_000_000
_LOCK_WAIT_S: Final = 5.0
_LARGEST: Final = 1e7  # of coordinates [m]


class GraphFile:
    """A graph file that is open for writing; what is saved is known, so only news are written."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self._path = path
        self._connection = connection
        self._keyframes = self._submaps = 0
        self._edges: list[Edge] = []
        self._sightings: list[Sighting] = []
        self._poses = np.zeros((0, 3))

    @classmethod
    def create(cls, path: Path, farthest: float, source: str) -> GraphFile:
        """Make a new file; `source` says in words what the map is made from.

        Raises `CairnError` if it exists or cannot be made.
        """
        if path.exists():
            raise CairnError(f"{path} exists already; remove it, or give another name")
        with _explained(path):
            path.touch(exist_ok=False)
            connection = _connect(path)
            with connection:
                for name, columns in _TABLES.items():
                    connection.execute(f"CREATE TABLE {name} ({columns})")
                connection.execute(
                    "INSERT INTO graph VALUES (?, ?, ?)", (farthest, time.time(), source)
                )
                connection.execute(f"PRAGMA application_id = {APPLICATION}")
                connection.execute(f"PRAGMA user_version = {_FORMAT}")
        return cls(path, connection)

    @classmethod
    def open(cls, path: Path) -> tuple[GraphFile, Mapper]:
        """Open a file to continue it; return a mapper with its content.

        Raises `CairnError` if there is no such file, or it is damaged.
        """
        mapper = read_graph(path)
        with _explained(path):
            file = cls(path, _connect(path))
        file._note(mapper)
        return file, mapper

    def save(self, mapper: Mapper) -> None:
        """Write what has changed since the last call; raises `CairnError` if that fails."""
        graph = mapper.graph
        edges_changed = any(
            old is not new for old, new in zip(self._edges, graph.edges, strict=False)
        ) or len(graph.edges) < len(self._edges)
        with _explained(self._path), self._connection as connection:
            connection.executemany(
                "INSERT INTO keyframes VALUES (?, ?, ?, ?, ?, ?, ?)",
                _keyframe_rows(mapper.keyframes, self._keyframes),
            )
            first = 0 if edges_changed else len(self._edges)
            if edges_changed:
                connection.execute("DELETE FROM edges")
            connection.executemany(
                "INSERT INTO edges VALUES (?, ?, ?, ?, ?, ?)", _edge_rows(graph.edges, first)
            )
            connection.executemany(
                "REPLACE INTO submaps VALUES (?, ?, ?)",
                [(s.number, s.first, s.last) for s in mapper.submaps[self._submaps :]],
            )
            connection.executemany(
                "REPLACE INTO sightings VALUES (?, ?, ?, ?)",
                _sighting_rows(graph.sightings, _first_change(self._sightings, graph.sightings)),
            )
            same = len(self._poses)
            if not np.array_equal(self._poses, graph.poses[:same]):
                same = 0
            connection.executemany(
                "REPLACE INTO poses VALUES (?, ?, ?, ?)",
                [
                    (number, *pose)
                    for number, pose in enumerate(graph.poses[same:].tolist(), start=same)
                ],
            )
            connection.execute("DELETE FROM landmarks")
            connection.executemany(
                "INSERT INTO landmarks VALUES (?, ?, ?)",
                [(landmark, x, y) for landmark, (x, y) in graph.landmarks.items()],
            )
        self._note(mapper)

    def seal(self) -> None:
        """Write everything into the one file, without a log beside it."""
        with _explained(self._path):
            self._connection.execute("PRAGMA journal_mode = DELETE")

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _note(self, mapper: Mapper) -> None:
        self._keyframes, self._submaps = len(mapper.keyframes), len(mapper.submaps)
        self._edges = list(mapper.graph.edges)
        self._sightings = list(mapper.graph.sightings)
        self._poses = mapper.graph.poses.copy()


def write_graph(path: Path, mapper: Mapper, source: str) -> None:
    """Write a whole graph to a new file, or replace one; raises `CairnError` if that fails."""
    with _explained(path), replacing(path) as part:
        file = GraphFile.create(part, mapper.farthest, source)
        with closing(file):
            file.save(mapper)
            file.seal()


def read_graph(path: Path) -> Mapper:
    """Return a mapper with the content of a file.

    Raises `CairnError` if there is no such file, or it is damaged.
    """
    if not path.is_file():
        raise CairnError(f"{path}: no such file; give a graph that `cairn map build` has written")
    with _explained(path), closing(_connect(path, read_only=True)) as connection:
        if (size := path.stat().st_size) > FILE_BYTES:
            raise too_large(path, size, FILE_BYTES)
        bound_connection(connection, longest=_LONGEST_VALUE, steps=_STEPS)
        _check(path, connection)
        try:
            return _read(connection)
        except (ValueError, TypeError, KeyError, IndexError) as error:
            raise _damaged(path, str(error)) from error


def _read(connection: sqlite3.Connection) -> Mapper:
    ((farthest,),) = connection.execute("SELECT farthest FROM graph").fetchall()
    mapper = Mapper(float(farthest))
    graph = mapper.graph
    for number, *columns in _rows(connection, "keyframes", "number"):
        if number != len(mapper.keyframes) or number >= _MOST_KEYFRAMES:
            raise ValueError(f"keyframe {len(mapper.keyframes)} is missing")
        mapper.keyframes.append(_keyframe(*columns))
    count = len(mapper.keyframes)
    poses = [row[1:] for row in _rows(connection, "poses", "number")]
    graph.poses = np.array(poses, np.float64).reshape(-1, 3)
    if len(graph.poses) != count or not np.all(np.abs(graph.poses) < _LARGEST):
        raise ValueError("poses are missing or not finite")
    for number, first, last in _rows(connection, "submaps", "number"):
        if number != len(mapper.submaps) or not 0 <= first <= last < count:
            raise ValueError(f"submap {number} is wrong")
        mapper.submaps.append(Submap(number, first, last))
    for _, kind, first, second, measured, information in _rows(connection, "edges", "number"):
        _check_keyframes(count, first, second)
        x, y, theta = _numbers(measured, 3)
        matrix = _floats(information, np.float64, 3)
        if matrix.shape != (3, 3):
            raise ValueError("the information of a constraint is wrong")
        graph.edges.append(Edge(EdgeKind(kind), first, second, (x, y, theta), matrix))
    for landmark, x, y in _rows(connection, "landmarks", "landmark"):
        if not max(abs(x), abs(y)) < _LARGEST:
            raise ValueError(f"landmark {landmark} is not in the map")
        graph.landmarks[landmark] = (x, y)
    for _, keyframe, landmark, measured in _rows(connection, "sightings", "number"):
        _check_keyframes(count, keyframe)
        if landmark not in graph.landmarks:
            raise ValueError(f"landmark {landmark} is missing")
        graph.sightings.append(Sighting(keyframe, landmark, *_numbers(measured, 4)))
    return mapper


def _keyframe(
    stamp_ns: int, submap: int, odometry: bytes, cloud: bytes, geometry: bytes | None, ranges: bytes
) -> Keyframe:
    points = _floats(cloud, np.float32, 4)
    x, y, theta = _numbers(odometry, 3)
    rays = None
    if geometry is not None:
        x1, y1, angle1, x2, y2, angle2, reach = _numbers(geometry, 7)
        beams = np.frombuffer(ranges, "<f4")
        rays = ScanRays((x1, y1, angle1), (x2, y2, angle2), beams, reach)
    surfaces = PointCloud(points[:, :2].copy(), points[:, 2:].copy())
    return Keyframe(stamp_ns, (x, y, theta), surfaces, rays, submap)


def _rows(connection: sqlite3.Connection, table: str, order: str) -> Iterator[tuple[Any, ...]]:
    return connection.execute(f"SELECT * FROM {table} ORDER BY {order}")


def _keyframe_rows(keyframes: Sequence[Keyframe], first: int) -> Iterable[tuple[object, ...]]:
    for number, frame in enumerate(keyframes[first:], start=first):
        cloud = np.concatenate((frame.cloud.points, frame.cloud.normals), axis=1)
        rays = frame.rays
        geometry = None
        if rays is not None:
            geometry = np.array((*rays.first, *rays.last, rays.reach), "<f8").tobytes()
        yield (
            number,
            frame.stamp_ns,
            frame.submap,
            np.array(frame.odometry, "<f8").tobytes(),
            cloud.astype("<f4").tobytes(),
            geometry,
            None if rays is None else rays.ranges.astype("<f4").tobytes(),
        )


def _edge_rows(edges: Sequence[Edge], first: int) -> Iterable[tuple[object, ...]]:
    for number, edge in enumerate(edges[first:], start=first):
        yield (
            number,
            int(edge.kind),
            edge.first,
            edge.second,
            np.array(edge.measured, "<f8").tobytes(),
            edge.information.astype("<f8").tobytes(),
        )


def _first_change(old: Sequence[Sighting], new: Sequence[Sighting]) -> int:
    """Return the number of the first sighting that was replaced or added."""
    pairs = enumerate(zip(old, new, strict=False))
    return next((number for number, (a, b) in pairs if a is not b), len(old))


def _sighting_rows(sightings: Sequence[Sighting], first: int) -> Iterable[tuple[object, ...]]:
    for number, s in enumerate(sightings[first:], start=first):
        measured = np.array((s.range_m, s.bearing, s.range_sd, s.bearing_sd), "<f8").tobytes()
        yield number, s.keyframe, s.landmark, measured


def _floats(blob: object, kind: type, columns: int) -> NDArray[np.float64]:
    if not isinstance(blob, bytes):
        raise TypeError("numbers are missing")
    values = np.frombuffer(blob, np.dtype(kind).newbyteorder("<")).reshape(-1, columns)
    if not np.isfinite(values).all():
        raise ValueError("numbers are not finite")
    return values.astype(np.float64)


def _numbers(blob: object, count: int) -> list[float]:
    values = _floats(blob, np.float64, count)
    if len(values) != 1:
        raise ValueError("numbers are missing")
    numbers: list[float] = values[0].tolist()
    return numbers


def _check_keyframes(count: int, *numbers: int) -> None:
    if not all(type(number) is int and 0 <= number < count for number in numbers):
        raise ValueError(f"keyframe {max(numbers)} is missing")


def _connect(path: Path, *, read_only: bool = False) -> sqlite3.Connection:
    if read_only:
        uri = f"file:{quote(str(path.absolute()))}?mode=ro"
        return sqlite3.connect(uri, uri=True, timeout=_LOCK_WAIT_S)
    # A component's handlers run one at a time, but not always on the same thread.
    connection = sqlite3.connect(path, timeout=_LOCK_WAIT_S, check_same_thread=False)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")
    return connection


def _check(path: Path, connection: sqlite3.Connection) -> None:
    ((application,),) = connection.execute("PRAGMA application_id").fetchall()
    ((version,),) = connection.execute("PRAGMA user_version").fetchall()
    if application != APPLICATION:
        raise CairnError(f"{path}: not a graph; give one that `cairn map build` has written")
    if version > _FORMAT:
        raise CairnError(
            f"{path}: its format {version} is newer than this Cairn, which knows {_FORMAT}; "
            "update Cairn"
        )
    try:
        found = table_columns(connection, _TABLES, ())
    except SchemaError as error:
        raise _damaged(path, str(error)) from error
    if set(found) != set(_TABLES):
        raise _damaged(path, "tables are missing")


def _damaged(path: Path, fault: str) -> CairnError:
    return CairnError(f"{path}: damaged graph: {fault}; restore a copy of it, or build it again")


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise CairnError(
            f"{path}: {error}; free disk space, restore a copy of the graph, or close the other "
            "program that uses it"
        ) from error
    except OSError as error:
        raise CairnError(f"{path}: {explain_os_error(error)}") from error
