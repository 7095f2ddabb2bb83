"""The graph file (SQLite): keyframes, submaps and constraints, from which mapping continues.

Keyframes and constraints are appended while the robot drives; poses are replaced when the graph was
optimized. A kill loses what was added since the last `save`, and never the file.
"""

from __future__ import annotations

import math
import sqlite3
import time
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cairn.components.slam.keyframes import Keyframe, ScanRays, Submap, scan_surfaces
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.point_cloud import PointCloud
from cairn.components.slam.pose_graph import Edge, EdgeKind, PoseGraph, Sighting
from cairn.errors import CairnError
from cairn.limits.files import too_large
from cairn.limits.sqlite import SchemaError, bound_connection, table_columns
from cairn.planar.motion_model import MEASURED, MotionModel
from cairn.planar.renewals import TILE, Renewals
from cairn.system.files import (
    complete_replacement,
    explain_os_error,
    remove_side_files,
    rename_database,
    replacing,
)
from cairn.visual_map.sqlite_file import at_rest

Array = NDArray[np.float64]

APPLICATION: Final = 0x4361_7267
"""SQLite's application id of a graph file, in the file's header: "Carg"."""

FILE_BYTES: Final = 4_000_000_000
"""Largest graph file [bytes]."""

LONGEST_VALUE: Final = 2_000_000
"""Most bytes of a value in it: the points of one scan."""

_FORMAT: Final = 3
# Lives and places have a row for each span of versions, from `since` until before `until`; NULL:
# until now. A keyframe belongs to the map in its lives. A place is a tile of `Renewals`. Keyframes
# with a number below `extended` are of the map that this one extends.
_TABLES: Final = {
    "graph": "farthest REAL NOT NULL, created_s REAL NOT NULL, source TEXT NOT NULL, "
    "origin TEXT NOT NULL, version INTEGER NOT NULL, oldest INTEGER NOT NULL, "
    "extended INTEGER NOT NULL",
    "keyframes": "number INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, submap INTEGER NOT NULL, "
    "version INTEGER NOT NULL, odometry BLOB NOT NULL, cloud BLOB NOT NULL, geometry BLOB, "
    "ranges BLOB",
    "lives": "keyframe INTEGER NOT NULL, since INTEGER NOT NULL, until INTEGER",
    "places": "tile_column INTEGER NOT NULL, tile_row INTEGER NOT NULL, since INTEGER NOT NULL, "
    "until INTEGER, versions BLOB NOT NULL",
    "changes": "version INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, kind TEXT NOT NULL, "
    "x REAL NOT NULL, y REAL NOT NULL, width REAL NOT NULL, height REAL NOT NULL, "
    "added INTEGER NOT NULL, removed INTEGER NOT NULL, reason TEXT NOT NULL",
    "poses": "number INTEGER PRIMARY KEY, x REAL NOT NULL, y REAL NOT NULL, theta REAL NOT NULL",
    "submaps": "number INTEGER PRIMARY KEY, first INTEGER NOT NULL, last INTEGER NOT NULL",
    "edges": "number INTEGER PRIMARY KEY, kind INTEGER NOT NULL, first INTEGER NOT NULL, "
    "second INTEGER NOT NULL, measured BLOB NOT NULL, information BLOB NOT NULL",
    "sightings": "number INTEGER PRIMARY KEY, keyframe INTEGER NOT NULL, "
    "landmark INTEGER NOT NULL, measured BLOB NOT NULL",
    "landmarks": "landmark INTEGER PRIMARY KEY, x REAL NOT NULL, y REAL NOT NULL",
}
# Tables that only a file with them has: the differences of a grid map that are not permanent yet.
DIFFERENCES: Final = "differences"
_MORE_TABLES: Final = {
    DIFFERENCES: "block_column INTEGER NOT NULL, block_row INTEGER NOT NULL, "
    "since_ns INTEGER NOT NULL, cells BLOB NOT NULL, PRIMARY KEY (block_column, block_row)"
}
_MOST_KEYFRAMES: Final = 500_000
_STEPS: Final = 400_000_000
_LOCK_WAIT_S: Final = 5.0
_LARGEST: Final = 1e7  # of coordinates [m]
_ROUNDED: Final = 1e-6  # share by which the numbers of a matrix are off
_VERSIONS: Final = 2**31  # of which numbers are smaller than this


class GraphFile:
    """A graph file that is open for writing; what is saved is known, so only news are written."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self._path = path
        self._connection = connection
        self._keyframes = self._submaps = 0
        self._edges: list[Edge] = []
        self._sightings: list[Sighting] = []
        self._poses = np.zeros((0, 3))
        self._has_tiles = False

    @classmethod
    def create(
        cls,
        path: Path,
        farthest: float,
        source: str,
        created_s: float | None = None,
        *,
        called: Path | None = None,
    ) -> GraphFile:
        """Make a new file; `source` says in words what the map is made from.

        `created_s` is the time of creation in the file [s since 1970], None: the system's. Raises
        `CairnError` if it exists or cannot be made. Errors name it `called`, by default `path`.
        """
        if path.exists():
            raise CairnError(f"{path} exists already; remove it, or give another name")
        called = called or path
        with explained_errors(called):
            # Complete or not at all: a restarted component would not continue half of a file.
            with replacing(path) as part, closing(sqlite3.connect(part)) as connection, connection:
                for name, columns in _TABLES.items():
                    connection.execute(f"CREATE TABLE {name} ({columns})")
                created_s = time.time() if created_s is None else created_s
                insert(connection, "graph", [(farthest, created_s, source, "", 0, 0, 0)])
                connection.execute(f"PRAGMA application_id = {APPLICATION}")
                connection.execute(f"PRAGMA user_version = {_FORMAT}")
            return cls(called, open_connection(path))

    @classmethod
    def open(cls, path: Path) -> tuple[GraphFile, Mapper]:
        """Open a file to continue it; return a mapper with its content.

        Raises `CairnError` if there is no such file, it is damaged, or it has changed since it was
        finished: such a map is extended in another file.
        """
        mapper = read_graph(path)
        with explained_errors(path):
            file = cls(path, open_connection(path))
        ((changes,),) = file._connection.execute("SELECT count(*) FROM changes").fetchall()
        if changes:
            file.close()
            raise CairnError(
                f"{path}: has a history of changes, so it is not continued; extend it "
                "(`extend`, --extend) and give another name for the new map"
            )
        file._note(mapper)
        return file, mapper

    def save(self, mapper: Mapper) -> None:
        """Write what has changed since the last call; raises `CairnError` if that fails."""
        graph = mapper.graph
        with explained_errors(self._path), self._connection as connection:
            insert_keyframes(connection, mapper.keyframes[self._keyframes :], self._keyframes)
            first = _first_change(self._edges, graph.edges)
            connection.execute("DELETE FROM edges WHERE number >= ?", (first,))
            insert_edges(connection, graph.edges[first:], first)
            submaps = [astuple(submap) for submap in mapper.submaps[self._submaps :]]
            insert(connection, "submaps", submaps, replacing=True)
            _replace_sightings(
                connection, graph.sightings, _first_change(self._sightings, graph.sightings)
            )
            same = len(self._poses)
            if not np.array_equal(self._poses, graph.poses[:same]):
                same = 0
            poses = enumerate(graph.poses[same:].tolist(), start=same)
            insert(connection, "poses", [(k, *pose) for k, pose in poses], replacing=True)
            connection.execute(
                "UPDATE graph SET version = ?, oldest = ?, extended = ?",
                (mapper.version, mapper.version, graph.extended),
            )
            if not self._has_tiles:
                insert_tiles(connection, mapper.renewals, mapper.renewals.tiles, mapper.version)
            connection.execute("DELETE FROM landmarks")
            insert(connection, "landmarks", [(k, *point) for k, point in graph.landmarks.items()])
        self._note(mapper)

    def seal(self) -> None:
        """Write everything into the one file, without a log beside it."""
        with explained_errors(self._path):
            self._connection.execute("PRAGMA journal_mode = DELETE")

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _note(self, mapper: Mapper) -> None:
        self._keyframes, self._submaps = len(mapper.keyframes), len(mapper.submaps)
        self._edges = list(mapper.graph.edges)
        self._sightings = list(mapper.graph.sightings)
        self._poses = mapper.graph.poses.copy()
        self._has_tiles = True


def write_graph(path: Path, mapper: Mapper, source: str) -> None:
    """Write a whole graph to a new file, or replace one; raises `CairnError` if that fails."""
    with (
        explained_errors(path),
        replacing(path) as part,
        closing(GraphFile.create(part, mapper.farthest, source, called=path)) as file,
    ):
        file.save(mapper)
        file.seal()


def read_graph(path: Path, model: MotionModel = MEASURED) -> Mapper:
    """Return a mapper with the content of a file, which continues with odometry of `model`.

    Raises `CairnError` if there is no such file, or it is damaged.
    """
    with opened(path) as connection:
        return _read(connection, model)


def kept_path(path: Path) -> Path:
    """Return where `set_aside` keeps a graph: NAME.before.graph for NAME.graph."""
    return path.with_name(f"{path.stem}.before{path.suffix}")


def set_aside(path: Path) -> Path | None:
    """Rename a graph, so that a new one can be made there; return its path, None without one.

    It replaces what was set aside before. Raises `CairnError` if the disk refuses it.
    """
    with explained_errors(path):
        if not path.exists():
            remove_side_files(path)
            return None
        kept = kept_path(path)
        rename_database(path, kept)
        return kept


@dataclass(frozen=True)
class GraphState:
    """The graph at one version of the map.

    Attributes:
        version: of the map.
        farthest: surfaces are known up to here from the scanner [m].
        numbers: of the keyframes in the file.
        keyframes: the same keyframes.
        poses: (n, 3) of them in the map.
        renewals: where only newer keyframes count.

    """

    version: int
    farthest: float
    numbers: list[int]
    keyframes: list[Keyframe]
    poses: Array
    renewals: Renewals


def read_state(connection: sqlite3.Connection, version: int | None = None) -> GraphState:
    """Return the graph at a version that the file keeps; None: the newest.

    Raises `ValueError` if the file is damaged.
    """
    ((farthest, newest, oldest),) = connection.execute(
        "SELECT farthest, version, oldest FROM graph"
    ).fetchall()
    if not (type(newest) is type(oldest) is int and 0 <= oldest <= newest < _VERSIONS):
        raise ValueError("the version of the map is wrong")
    if not 0.0 < farthest < _LARGEST:
        raise ValueError(f"its largest range {farthest!r} is wrong")
    at = newest if version is None else version
    alive = {
        number
        for (number,) in connection.execute(
            "SELECT keyframe FROM lives WHERE since <= ? AND coalesce(until, 1e18) > ? LIMIT ?",
            (at, at, _MOST_KEYFRAMES + 1),
        )
    }
    if len(alive) > _MOST_KEYFRAMES:
        raise ValueError(f"it has more than {_MOST_KEYFRAMES} keyframes")
    state = GraphState(at, float(farthest), [], [], np.zeros((0, 3)), _renewals(connection, at))
    for number, *columns in _rows(connection, "keyframes", "number"):
        if number in alive:
            state.numbers.append(number)
            state.keyframes.append(_keyframe(*columns))
    if len(state.numbers) != len(alive):
        raise ValueError("keyframes are missing")
    places = {number: row for number, *row in _rows(connection, "poses", "number")}
    poses = np.array([places.get(k, (math.nan,) * 3) for k in state.numbers], np.float64)
    if not np.all(np.abs(poses) < _LARGEST):
        raise ValueError("poses are missing or not finite")
    return replace(state, poses=poses.reshape(-1, 3))


def read_surfaces(connection: sqlite3.Connection) -> Array:
    """Return the ends (n, 2) [m] of the rays of all keyframes in the file, also of retired ones.

    Raises `ValueError` if the file is damaged.
    """
    places = {number: row for number, *row in _rows(connection, "poses", "number")}
    ends = [np.zeros((0, 2))]
    for number, *columns in _rows(connection, "keyframes", "number"):
        rays = _keyframe(*columns).rays
        if rays is not None and number in places:
            x, y, theta = places[number]
            ends.append(rays.rays().placed((x, y, theta)).points())
    return np.concatenate(ends)


def read_edges(connection: sqlite3.Connection, numbers: Sequence[int]) -> list[Edge]:
    """Return the constraints between these keyframes, by their numbers in the file.

    Raises `ValueError` if the file is damaged.
    """
    wanted = set(numbers)
    known = {number for (number,) in connection.execute("SELECT number FROM keyframes")}
    edges = []
    for _, kind, first, second, measured, information in _rows(connection, "edges", "number"):
        x, y, theta = _numbers(measured, 3)
        matrix = _floats(information, np.float64, 3)
        if matrix.shape != (3, 3) or not _is_information(matrix, EdgeKind(kind)):
            raise ValueError("the information of a constraint is wrong")
        if not {first, second} <= known:
            raise ValueError(f"a keyframe of the constraint {first}, {second} is missing")
        if first in wanted and second in wanted:
            edges.append(Edge(EdgeKind(kind), first, second, (x, y, theta), matrix))
    return edges


def _renewals(connection: sqlite3.Connection, version: int) -> Renewals:
    tiles = {}
    for column, row, blob in connection.execute(
        "SELECT tile_column, tile_row, versions FROM places "
        "WHERE since <= ? AND coalesce(until, 1e18) > ?",
        (version, version),
    ):
        tile = np.frombuffer(blob, "<i4").reshape(TILE, TILE)
        if type(column) is not int or type(row) is not int or not (tile >= 0).all():
            raise ValueError("a renewed place is wrong")
        tiles[column, row] = tile.astype(np.int32)
    return Renewals(tiles)


def _read(connection: sqlite3.Connection, model: MotionModel) -> Mapper:
    """Return a mapper with the newest state, in which keyframes are numbered from 0."""
    state = read_state(connection)
    mapper = Mapper(state.farthest, model)
    mapper.version, mapper.renewals = state.version, state.renewals
    read_constraints(connection, state, mapper.graph)
    submap_of: dict[int, int] = {}
    for submap, first, last in _rows(connection, "submaps", "number"):
        if not type(first) is type(last) is int:
            raise ValueError(f"submap {submap} is wrong")
        begin, end = bisect_left(state.numbers, first), bisect_right(state.numbers, last)
        if begin < end:
            if mapper.submaps and begin <= mapper.submaps[-1].last:
                raise ValueError(f"submap {submap} overlaps another one")
            submap_of[submap] = len(mapper.submaps)
            mapper.submaps.append(Submap(len(mapper.submaps), begin, end - 1))
    for frame, pose in zip(state.keyframes, state.poses, strict=True):
        # A keyframe of the submap that was not finished is in none of these.
        submap = submap_of.get(frame.submap, len(mapper.submaps))
        mapper.keyframes.append(replace(_valid_part(frame, pose, state.renewals), submap=submap))
    return mapper


def read_constraints(connection: sqlite3.Connection, state: GraphState, graph: PoseGraph) -> None:
    """Add to an empty graph the poses of a state, the constraints between them, and landmarks.

    Raises `ValueError` if the file is damaged.
    """
    graph.poses = state.poses
    ((extended,),) = connection.execute("SELECT extended FROM graph").fetchall()
    if type(extended) is not int:
        raise ValueError("the number of keyframes that it extends is wrong")
    graph.extended = bisect_left(state.numbers, extended)
    index = {number: k for k, number in enumerate(state.numbers)}
    for edge in read_edges(connection, state.numbers):
        graph.edges.append(replace(edge, first=index[edge.first], second=index[edge.second]))
    landmarks = {}
    for landmark, x, y in _rows(connection, "landmarks", "landmark"):
        if not max(abs(x), abs(y)) < _LARGEST:
            raise ValueError(f"landmark {landmark} is not in the map")
        landmarks[landmark] = (x, y)
    for number, keyframe, landmark, measured in _rows(connection, "sightings", "number"):
        if landmark not in landmarks:
            raise ValueError(f"landmark {landmark} is missing")
        sighting = Sighting(index.get(keyframe, -1), landmark, *_numbers(measured, 4))
        if not min(sighting.range_sd, sighting.bearing_sd) > 0.0:
            raise ValueError(f"the standard deviations of sighting {number} are wrong")
        if keyframe in index:
            graph.landmarks[landmark] = landmarks[landmark]
            graph.sightings.append(sighting)


def _valid_part(frame: Keyframe, pose: Array, renewals: Renewals) -> Keyframe:
    """Return a keyframe without the points that lie where newer keyframes alone count."""
    if not renewals.tiles or not frame.surfaces.count:
        return frame
    x, y, theta = pose.tolist()
    valid = renewals.since(frame.cloud.placed((x, y, theta)).points) <= frame.version
    surfaces = replace(frame.surfaces, values=frame.surfaces.values[valid])
    return replace(frame, surfaces=surfaces)


def _keyframe(
    stamp_ns: int,
    submap: int,
    version: int,
    odometry: bytes,
    cloud: bytes,
    geometry: bytes | None,
    ranges: bytes,
) -> Keyframe:
    if not (type(stamp_ns) is type(submap) is type(version) is int and 0 <= version < _VERSIONS):
        raise ValueError("numbers of a keyframe are wrong")
    points = _floats(cloud, np.float32, 4)
    surfaces = scan_surfaces(PointCloud(points[:, :2], points[:, 2:]))
    x, y, theta = _numbers(odometry, 3)
    rays = None
    if geometry is not None:
        x1, y1, angle1, x2, y2, angle2, reach = _numbers(geometry, 7)
        beams = np.frombuffer(ranges, "<f4")
        rays = ScanRays((x1, y1, angle1), (x2, y2, angle2), beams, reach)
    return Keyframe(stamp_ns, (x, y, theta), surfaces, rays, submap, version)


def _rows(connection: sqlite3.Connection, table: str, order: str) -> Iterator[tuple[Any, ...]]:
    return connection.execute(f"SELECT * FROM {table} ORDER BY {order}")


def insert(
    connection: sqlite3.Connection,
    table: str,
    rows: Sequence[Sequence[object]],
    *,
    replacing: bool = False,
) -> None:
    """Add rows to a table, or with `replacing`, put them in the place of those with their keys."""
    if rows:
        verb = "REPLACE" if replacing else "INSERT"
        values = ", ".join("?" * len(rows[0]))
        connection.executemany(f"{verb} INTO {table} VALUES ({values})", rows)


def insert_keyframes(
    connection: sqlite3.Connection, keyframes: Iterable[Keyframe], first: int
) -> None:
    """Add keyframes, numbered from `first` on; each belongs to the map from its version on."""
    rows = []
    for number, frame in enumerate(keyframes, start=first):
        cloud, rays = frame.cloud, frame.rays
        geometry = ranges = None
        if rays is not None:
            geometry = _packed((*rays.first, *rays.last, rays.reach))
            ranges = rays.ranges.astype("<f4").tobytes()
        surfaces = np.concatenate((cloud.points, cloud.normals), axis=1).astype("<f4").tobytes()
        rows.append((number, frame.stamp_ns, frame.submap, frame.version,
                     _packed(frame.odometry), surfaces, geometry, ranges))  # fmt: skip
    insert(connection, "keyframes", rows)
    insert(connection, "lives", [(number, version, None) for number, _, _, version, *_ in rows])


def insert_tiles(
    connection: sqlite3.Connection,
    renewals: Renewals,
    tiles: Iterable[tuple[int, int]],
    version: int,
) -> None:
    """Add tiles of renewed places, by column and row; they hold from a version on."""
    packed = {tile: renewals.tiles[tile].astype("<i4").tobytes() for tile in tiles}
    insert(connection, "places", [(*tile, version, None, blob) for tile, blob in packed.items()])


def insert_edges(connection: sqlite3.Connection, edges: Iterable[Edge], first: int) -> None:
    """Add constraints, numbered from `first` on."""
    rows = [
        (k, int(one.kind), one.first, one.second, _packed(one.measured), _packed(one.information))
        for k, one in enumerate(edges, start=first)
    ]
    insert(connection, "edges", rows)


def _packed(numbers: ArrayLike) -> bytes:
    return np.array(numbers, "<f8").tobytes()


def _first_change(old: Sequence[object], new: Sequence[object]) -> int:
    """Return the number of the first object that was replaced, added, or removed."""
    pairs = enumerate(zip(old, new, strict=False))
    return next((k for k, (a, b) in pairs if a is not b), min(len(old), len(new)))


def _replace_sightings(
    connection: sqlite3.Connection, sightings: Sequence[Sighting], first: int
) -> None:
    rows = [
        (k, s.keyframe, s.landmark, _packed((s.range_m, s.bearing, s.range_sd, s.bearing_sd)))
        for k, s in enumerate(sightings[first:], start=first)
    ]
    insert(connection, "sightings", rows, replacing=True)


def _floats(blob: object, kind: type, columns: int) -> NDArray[np.float64]:
    if not isinstance(blob, bytes):
        raise TypeError("numbers are missing")
    values = np.frombuffer(blob, np.dtype(kind).newbyteorder("<")).reshape(-1, columns)
    if not np.isfinite(values).all():
        raise ValueError("numbers are not finite")
    return values.astype(np.float64)


def _is_information(matrix: Array, kind: EdgeKind) -> bool:
    """Return whether a matrix (3, 3) is symmetric, and negative in no direction.

    A step says something in each direction; others may say nothing along a wall.
    """
    size = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > _ROUNDED * size:
        return False
    least = float(np.linalg.eigvalsh(matrix)[0])
    is_step = kind in (EdgeKind.STEP, EdgeKind.ODOMETRY)
    return least > 0.0 if is_step else least >= -_ROUNDED * size


def _numbers(blob: object, count: int) -> list[float]:
    values = _floats(blob, np.float64, count)
    if len(values) != 1:
        raise ValueError("numbers are missing")
    numbers: list[float] = values[0].tolist()
    return numbers


def create_differences(connection: sqlite3.Connection) -> None:
    """Create the table of differences if a file does not have it."""
    columns = _MORE_TABLES[DIFFERENCES]
    connection.execute(f"CREATE TABLE IF NOT EXISTS {DIFFERENCES} ({columns})")


def open_connection(path: Path, *, read_only: bool = False) -> sqlite3.Connection:
    """Connect to a graph file; raises `sqlite3.Error` or `ValueError` if that fails."""
    if read_only:
        # A graph at rest may be in a folder where SQLite cannot make its lock files.
        uri = f"{path.resolve().as_uri()}?{'immutable=1' if at_rest(path) else 'mode=ro'}"
        return sqlite3.connect(uri, uri=True, timeout=_LOCK_WAIT_S)
    # A component's handlers run one at a time, but not always on the same thread.
    connection = sqlite3.connect(path, timeout=_LOCK_WAIT_S, check_same_thread=False)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
    except BaseException:
        connection.close()
        raise
    return connection


@contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a graph to read it; raise `CairnError` if there is none, or it is damaged."""
    check_exists(path)
    with explained_damage(path), closing(open_connection(path, read_only=True)) as connection:
        if (size := path.stat().st_size) > FILE_BYTES:
            raise too_large(path, size, FILE_BYTES)
        bound_connection(connection, longest=LONGEST_VALUE, steps=_STEPS)
        check_format(path, connection)
        yield connection


def check_format(path: Path, connection: sqlite3.Connection) -> None:
    """Raise `CairnError` unless a file is a graph of this format."""
    ((application,),) = connection.execute("PRAGMA application_id").fetchall()
    ((version,),) = connection.execute("PRAGMA user_version").fetchall()
    if application != APPLICATION:
        raise _not_a_graph(path)
    if version < _FORMAT:
        raise CairnError(
            f"{path}: its format {version} is older than this Cairn, which reads {_FORMAT}; "
            "build the map again"
        )
    if version > _FORMAT:
        raise CairnError(
            f"{path}: its format {version} is newer than this Cairn, which knows {_FORMAT}; "
            "update Cairn"
        )
    try:
        found = table_columns(connection, _TABLES.keys() | _MORE_TABLES.keys(), ())
    except SchemaError as error:
        raise _damaged(path, str(error)) from error
    if not _TABLES.keys() <= found.keys():
        raise _damaged(path, "tables are missing")


def check_exists(path: Path) -> None:
    """Raise `CairnError` if there is no such file."""
    complete_replacement(path)
    if not path.is_file():
        fault = "is not a file" if path.exists() else "no such file"
        raise CairnError(f"{path}: {fault}; give a graph that `cairn map build` has written")


def _not_a_graph(path: Path) -> CairnError:
    return CairnError(f"{path}: not a graph; give one that `cairn map build` has written")


def _damaged(path: Path, fault: str) -> CairnError:
    return CairnError(f"{path}: damaged graph: {fault}; restore a copy of it, or build it again")


_WRITABLE: Final = "make the file and its folder writable, or free disk space"
_CLOSE: Final = "close the other program that uses it"
_REMEDIES: Final = {
    sqlite3.SQLITE_FULL: "free disk space",
    sqlite3.SQLITE_READONLY: _WRITABLE,
    sqlite3.SQLITE_CANTOPEN: _WRITABLE,
    sqlite3.SQLITE_IOERR: _WRITABLE,
    sqlite3.SQLITE_BUSY: _CLOSE,
    sqlite3.SQLITE_LOCKED: _CLOSE,
    sqlite3.SQLITE_CORRUPT: "restore a copy of the graph, or build it again",
}
_ANY_REMEDY: Final = f"free disk space, restore a copy of the graph, or {_CLOSE}"


@contextmanager
def explained_errors(path: Path) -> Iterator[None]:
    """Raise errors of SQLite and of the disk as `CairnError`, with a remedy."""
    try:
        yield
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_NOTADB:
            raise _not_a_graph(path) from error
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        raise CairnError(f"{path}: {error}; {_REMEDIES.get(code, _ANY_REMEDY)}") from error
    except UnicodeDecodeError as error:  # of a text in the schema
        raise _damaged(path, str(error)) from error
    except OSError as error:
        raise CairnError(f"{path}: {explain_os_error(error, path)}") from error


@contextmanager
def explained_damage(path: Path) -> Iterator[None]:
    """Raise errors of SQLite, of the disk, and of wrong content as `CairnError`."""
    with explained_errors(path):
        try:
            yield
        except (ValueError, TypeError, KeyError, IndexError) as error:
            raise _damaged(path, str(error)) from error
