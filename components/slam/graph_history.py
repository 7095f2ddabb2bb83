"""Changes of a finished graph file: renewed places, their history, and the return to earlier times.

Each change has a version, from 1 on. The file keeps the graph at each version from `oldest` on. A
change is on the disk when the call that makes it returns.
"""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.graph_file import (
    DIFFERENCES,
    LONGEST_VALUE,
    GraphState,
    check_exists,
    check_format,
    create_differences,
    explained_damage,
    explained_errors,
    insert,
    insert_edges,
    insert_keyframes,
    insert_tiles,
    open_connection,
    opened,
    read_constraints,
    read_edges,
    read_state,
    read_surfaces,
)
from cairn.components.slam.keyframes import Keyframe
from cairn.components.slam.pose_graph import Edge, PoseGraph
from cairn.errors import CairnError
from cairn.limits.sqlite import bound_connection, replaced_by_copy
from cairn.planar.grid import OCCUPIED, changed_window
from cairn.planar.poses import Pose
from cairn.planar.renewals import Renewals
from cairn.planar.scan_grid import ScanGrid

Array = NDArray[np.float64]

# Free pages that are returned to the disk when the file is opened: with fewer, or a smaller share
# of the file, writing the whole file again is not worth it.
_FREE_PAGES, _FREE_SHARE = 256, 0.5
_COMPARED_M: Final = 0.05  # size of the cells in which a rollback is counted [m]


@dataclass(frozen=True)
class GraphChange:
    """A change of the map.

    Attributes:
        stamp_ns: when it was made [ns].
        kind: `added` or `removed` obstacles, `changed` (both), or `rollback`.
        x: middle of the changed place in the map [m].
        y: the same.
        width: of the changed place [m].
        height: the same.
        added: number of cells that became obstacles.
        removed: number of cells that are obstacles no more.
        reason: in words.

    """

    stamp_ns: int
    kind: str
    x: float
    y: float
    width: float
    height: float
    added: int
    removed: int
    reason: str


@dataclass(frozen=True)
class Renewal:
    """What a change adds to the graph, and what it retires.

    Attributes:
        change: its row of the history.
        poses: of the new keyframes in the map.
        keyframes: the new ones, which form a submap.
        renewals: of the whole map after the change.
        retired: numbers of keyframes that belong to the map no more.
        edges: constraints of the new keyframes, and those that replace retired ones.

    """

    change: GraphChange
    poses: Sequence[Pose]
    keyframes: Sequence[Keyframe]
    renewals: Renewals
    retired: Collection[int]
    edges: Sequence[Edge]


@dataclass(frozen=True)
class ChangedBlock:
    """A block of the grid map that differs from the map of the graph.

    Attributes:
        since_ns: when it was first seen to differ [ns].
        cells: that differ, as rows and columns of the grid map.

    """

    since_ns: int
    cells: frozenset[tuple[int, int]]


class GraphHistory:
    """A graph file that is open for changes of finished maps."""

    def __init__(self, path: Path) -> None:
        """Open a file; raises `CairnError` if there is none, or it is damaged or in use."""
        check_exists(path)
        self.path = path
        """The file."""
        with explained_errors(path):
            self._connection = open_connection(path)
        try:
            with explained_damage(self.path):
                check_format(path, self._connection)
                # A change that was reported must not be lost in a power cut.
                self._connection.execute("PRAGMA synchronous = FULL")
                self._return_free_pages()  # attaches a file, which is not allowed later
                bound_connection(self._connection, longest=LONGEST_VALUE)
        except CairnError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> GraphHistory:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()

    def seal(self) -> None:
        """Write everything into the one file, without a log beside it.

        Raises `CairnError` if another program has the file open.
        """
        with explained_errors(self.path):
            self._connection.execute("PRAGMA journal_mode = DELETE")

    def state(self, version: int | None = None) -> GraphState:
        """Return the map at a version that the file keeps; None: the newest.

        Islands that nothing joins to it have no position there, and are left out. Raises
        `CairnError` if the file is damaged.
        """
        with explained_damage(self.path):
            return _map_in(self._connection, read_state(self._connection, version))

    def seen_surfaces(self) -> Array:
        """Return the ends of rays (n, 2) [m] of all keyframes that the file keeps, in the map.

        Raises `CairnError` if the file is damaged.
        """
        with explained_damage(self.path):
            return read_surfaces(self._connection)

    def edges(self, numbers: Sequence[int]) -> list[Edge]:
        """Return the constraints between some keyframes; raises `CairnError` as `state`."""
        with explained_damage(self.path):
            return read_edges(self._connection, numbers)

    def versions(self) -> tuple[int, int]:
        """Return the oldest version that the file keeps, and the present one."""
        with explained_damage(self.path):
            ((oldest, newest),) = self._connection.execute(
                "SELECT oldest, version FROM graph"
            ).fetchall()
            return int(oldest), int(newest)

    def next_number(self) -> int:
        """Return the number of the next keyframe."""
        with explained_damage(self.path):
            return _next(self._connection, "keyframes")

    def renew(self, before: int, renewal: Renewal) -> int:
        """Make a change of the map of version `before`; return the new version.

        Raises `CairnError` if it cannot be written, or if the map has another version now: then the
        file is as it was.
        """
        with self._changing(before) as (connection, version):
            _end_submap(connection)
            number, submap = _next(connection, "keyframes"), _next(connection, "submaps")
            last = number + len(renewal.keyframes) - 1
            if renewal.keyframes:
                insert(connection, "submaps", [(submap, number, last)])
            frames = [replace(frame, submap=submap) for frame in renewal.keyframes]
            insert_keyframes(connection, frames, number)
            poses = enumerate(renewal.poses, start=number)
            insert(connection, "poses", [(k, *pose) for k, pose in poses])
            insert_edges(connection, renewal.edges, _next(connection, "edges"))
            _end_lives(connection, renewal.retired, version)
            _replace_tiles(connection, renewal.renewals, version)
            insert(connection, "changes", [(version, *astuple(renewal.change))])
        return version

    def retire(self, retired: Collection[int], edges: Sequence[Edge]) -> None:
        """End the lives of keyframes that the map does not need; constraints replace them.

        The map stays the same, so this makes no version. Raises `CairnError` as `renew`.
        """
        with explained_errors(self.path), self._connection as connection:
            ((version,),) = connection.execute("SELECT version FROM graph").fetchall()
            insert_edges(connection, edges, _next(connection, "edges"))
            _end_lives(connection, retired, version)

    def differences(self) -> dict[tuple[int, int], ChangedBlock]:
        """Return the noted differences by column and row of their block.

        Raises `CairnError` if the file is damaged.
        """
        with explained_damage(self.path):
            tables = self._connection.execute("SELECT name FROM sqlite_schema").fetchall()
            if (DIFFERENCES,) not in tables:
                return {}
            return {
                (int(column), int(row)): ChangedBlock(int(since_ns), _cells_of(cells))
                for column, row, since_ns, cells in self._connection.execute(
                    f"SELECT block_column, block_row, since_ns, cells FROM {DIFFERENCES}"
                )
            }

    def note_differences(
        self, noted: Mapping[tuple[int, int], ChangedBlock], gone: Collection[tuple[int, int]]
    ) -> None:
        """Note differences, in place of earlier ones of the same blocks, and delete others.

        Raises `CairnError` if they cannot be written.
        """
        rows = [
            (*block, one.since_ns, np.array(sorted(one.cells), "<i4").tobytes())
            for block, one in sorted(noted.items())
        ]
        with explained_errors(self.path), self._connection as connection:
            connection.execute("BEGIN IMMEDIATE")
            create_differences(connection)
            connection.executemany(
                f"DELETE FROM {DIFFERENCES} WHERE block_column = ? AND block_row = ?", sorted(gone)
            )
            insert(connection, DIFFERENCES, rows, replacing=True)

    def rollback(self, version: int, stamp_ns: int, reason: str) -> int:
        """Return to the map of an earlier version, as a change; return the new version.

        Raises `CairnError` if the file does not keep that version, or cannot be written.
        """
        oldest, newest = self.versions()
        if not oldest <= version <= newest:
            raise CairnError(
                f"{self.path}: keeps the versions {oldest} to {newest} of the map; "
                f"{version} is not one of them"
            )
        if version == newest:
            raise CairnError(f"{self.path}: the map is that of version {version} now")
        then, now = self.state(version), self.state()
        gone, back = set(now.numbers) - set(then.numbers), set(then.numbers) - set(now.numbers)
        change = _rollback_change(then, now, stamp_ns, reason)
        with self._changing(newest) as (connection, new):
            _end_lives(connection, gone, new)
            insert(connection, "lives", [(number, new, None) for number in sorted(back)])
            _replace_tiles(connection, then.renewals, new)
            insert(connection, "changes", [(new, *astuple(change))])
        return new

    def prune(self, *, keyframes: int, tiles: int, changes: int) -> None:
        """Delete the oldest history: keep so many retired keyframes, former tiles, and changes.

        Raises `CairnError` if that fails.
        """
        with explained_errors(self.path), self._connection as connection:
            oldest = max(
                _excess(connection, keyframes, _ENDED_KEYFRAMES),
                _excess(connection, tiles, _ENDED_TILES),
            )
            if oldest:
                _forget(connection, oldest)
            connection.execute(
                "DELETE FROM changes WHERE version < (SELECT oldest FROM graph) AND version <= "
                "(SELECT max(version) FROM changes) - ?",
                (changes,),
            )

    def _return_free_pages(self) -> None:
        ((free,),) = self._connection.execute("PRAGMA freelist_count").fetchall()
        ((pages,),) = self._connection.execute("PRAGMA page_count").fetchall()
        if free > _FREE_PAGES and free > _FREE_SHARE * pages:
            self._connection.execute("VACUUM")

    @contextmanager
    def _changing(self, before: int) -> Iterator[tuple[sqlite3.Connection, int]]:
        with explained_errors(self.path), self._connection as connection:
            connection.execute("BEGIN IMMEDIATE")
            ((version,),) = connection.execute("SELECT version FROM graph").fetchall()
            if version != before:
                raise CairnError(
                    f"{self.path}: another program has changed the map to version {version}; "
                    "restart this one"
                )
            yield connection, version + 1
            connection.execute("UPDATE graph SET version = ?", (version + 1,))


def copy_graph(original: Path, copy: Path) -> None:
    """Copy a graph, also from a read-only place, completely or not at all.

    The copy knows which graph it is of. Raises `CairnError` if it cannot be written.
    """
    origin = graph_digest(original)
    with (
        explained_errors(copy),
        closing(open_connection(original, read_only=True)) as source,
        replaced_by_copy(source, copy) as target,
    ):
        target.execute("UPDATE graph SET origin = ?", (origin,))
        target.execute(f"DROP TABLE IF EXISTS {DIFFERENCES}")


@contextmanager
def copy_at_rest(original: Path, copy: Path) -> Iterator[GraphHistory]:
    """Yield a copy of a graph, open for changes; no other program can change the original then.

    Raises `CairnError` if another program has it open, `OSError` if it cannot be copied.
    """
    with GraphHistory(original) as graph:
        graph.seal()
        with explained_errors(original):
            graph._connection.execute("BEGIN EXCLUSIVE")
        shutil.copyfile(original, copy)
        with GraphHistory(copy) as changed:
            yield changed


def graph_digest(path: Path) -> str:
    """Return a digest of a graph; raises `CairnError` if there is none, or it is damaged."""
    content = hashlib.sha256()
    with opened(path) as connection:
        for table in ("graph", "poses", "places"):
            for row in connection.execute(f"SELECT * FROM {table} ORDER BY 1, 2"):
                content.update(repr(row).encode())
    return content.hexdigest()


@dataclass(frozen=True)
class GraphLog:
    """What a graph file says about its past.

    Attributes:
        origin: digest of the graph of which it is a copy, "" for an original.
        oldest: version that the file keeps.
        version: of the map now.
        changes: versions and the changes that led to them, oldest first; those to versions before
            `oldest` are listed as far as there is room.

    """

    origin: str
    oldest: int
    version: int
    changes: list[tuple[int, GraphChange]]

    @property
    def last_stamp_ns(self) -> int:
        """Time of the last change [ns]; 0 without one."""
        return self.changes[-1][1].stamp_ns if self.changes else 0

    def version_at(self, stamp_ns: int) -> int | None:
        """Return the version of the map at a time [ns]; None if it is not kept any more."""
        before = [version for version, change in self.changes if change.stamp_ns <= stamp_ns]
        version = before[-1] if before else 0
        return version if version >= self.oldest else None


def read_log(path: Path) -> GraphLog:
    """Return the past of a graph; raises `CairnError` if there is none, or it is damaged."""
    with opened(path) as connection:
        ((origin, oldest, version),) = connection.execute(
            "SELECT origin, oldest, version FROM graph"
        ).fetchall()
        return GraphLog(str(origin), int(oldest), int(version), _changes(connection))


def draw_state(state: GraphState, resolution: float) -> ScanGrid:
    """Return the drawn map of a graph, with cells of `resolution` [m].

    Raises `ValueError` if the map became too large.
    """
    drawing = ScanGrid(resolution, state.farthest)
    drawing.renew(state.renewals)
    for frame, (x, y, theta) in zip(state.keyframes, state.poses.tolist(), strict=True):
        if frame.rays is not None:
            drawing.add((x, y, theta), frame.rays.rays(), frame.version)
    return drawing


def change_between(
    old: NDArray[np.int8],
    new: NDArray[np.int8],
    corner: tuple[int, int],
    resolution: float,
    stamp_ns: int,
    reason: str,
    kind: str = "",
) -> GraphChange:
    """Return the row of the history for a change of obstacles.

    Args:
        old: cells (rows, columns) of a window of the map before.
        new: the same after the change.
        corner: row and column of the window's first cell, counted from the map's origin.
        resolution: size of a cell [m].
        stamp_ns: time of the change [ns].
        reason: of the change.
        kind: of the change; "": it follows from the cells.

    """
    before, after = old == OCCUPIED, new == OCCUPIED
    counts = int(np.count_nonzero(after & ~before)), int(np.count_nonzero(before & ~after))
    x, y, width, height = 0.0, 0.0, 0.0, 0.0
    if (window := changed_window(before, after)) is not None:
        left, right = corner[1] + window[1].start, corner[1] + window[1].stop
        bottom, top = corner[0] + window[0].start, corner[0] + window[0].stop
        x, y = 0.5 * (left + right) * resolution, 0.5 * (bottom + top) * resolution
        width, height = (right - left) * resolution, (top - bottom) * resolution
    if not kind:
        kind = "changed" if all(counts) else "added" if counts[0] else "removed"
    x, y, width, height = (round(value, 6) for value in (x, y, width, height))
    return GraphChange(stamp_ns, kind, x, y, width, height, *counts, reason)


# Versions at which keyframes and tiles ended that are in the map no more, newest first.
_ENDED_KEYFRAMES: Final = (
    "SELECT max(coalesce(until, 2147483647)) AS ended FROM lives GROUP BY keyframe "
    "HAVING ended < 2147483647 ORDER BY ended DESC"
)
_ENDED_TILES: Final = "SELECT until FROM places WHERE until IS NOT NULL ORDER BY until DESC"


def _excess(connection: sqlite3.Connection, most: int, query: str) -> int:
    """Return the oldest version that can be kept with `most` rows of a query."""
    rows = connection.execute(f"{query} LIMIT 1 OFFSET ?", (most,)).fetchall()
    return int(rows[0][0]) if rows else 0


def _forget(connection: sqlite3.Connection, oldest: int) -> None:
    connection.execute("UPDATE graph SET oldest = max(oldest, ?)", (oldest,))
    connection.execute("DELETE FROM lives WHERE until <= ?", (oldest,))
    connection.execute("DELETE FROM places WHERE until <= ?", (oldest,))
    connection.execute("DELETE FROM keyframes WHERE number NOT IN (SELECT keyframe FROM lives)")
    known = "(SELECT number FROM keyframes)"
    connection.execute(f"DELETE FROM poses WHERE number NOT IN {known}")
    connection.execute(f"DELETE FROM edges WHERE first NOT IN {known} OR second NOT IN {known}")
    connection.execute(f"DELETE FROM sightings WHERE keyframe NOT IN {known}")
    connection.execute(
        "DELETE FROM submaps WHERE NOT EXISTS "
        "(SELECT 1 FROM keyframes k WHERE k.number BETWEEN submaps.first AND submaps.last)"
    )


def _changes(connection: sqlite3.Connection) -> list[tuple[int, GraphChange]]:
    found = []
    for version, *columns in connection.execute("SELECT * FROM changes ORDER BY version"):
        change = GraphChange(*columns)
        numbers = (change.x, change.y, change.width, change.height)
        if (
            not type(change.stamp_ns) is type(change.added) is type(change.removed) is int
            or not np.isfinite(np.array(numbers, np.float64)).all()
            or not type(change.kind) is type(change.reason) is str
        ):
            raise ValueError(f"change {version} is wrong")
        found.append((int(version), change))
    return found


def _cells_of(blob: bytes) -> frozenset[tuple[int, int]]:
    cells = np.frombuffer(blob, "<i4").reshape(-1, 2)
    return frozenset((row, column) for row, column in cells.tolist())


def _end_lives(connection: sqlite3.Connection, numbers: Collection[int], version: int) -> None:
    connection.executemany(
        "UPDATE lives SET until = ? WHERE keyframe = ? AND until IS NULL",
        [(version, number) for number in sorted(numbers)],
    )


def _replace_tiles(connection: sqlite3.Connection, renewals: Renewals, version: int) -> None:
    """End the tiles that differ from `renewals`, and add the new ones."""
    known: dict[tuple[int, int], bytes] = {
        (column, row): blob
        for column, row, blob in connection.execute(
            "SELECT tile_column, tile_row, versions FROM places WHERE until IS NULL"
        )
    }
    wanted = {key: tile.astype("<i4").tobytes() for key, tile in renewals.tiles.items()}
    ended = [key for key, blob in known.items() if wanted.get(key) != blob]
    connection.executemany(
        "UPDATE places SET until = ? WHERE tile_column = ? AND tile_row = ? AND until IS NULL",
        [(version, *key) for key in sorted(ended)],
    )
    new = [key for key, blob in wanted.items() if known.get(key) != blob]
    insert_tiles(connection, renewals, sorted(new), version)


def _end_submap(connection: sqlite3.Connection) -> None:
    """Make a submap of the last keyframes if they are in none, as a robot that maps leaves them."""
    ((first, last),) = connection.execute(
        "SELECT min(number), max(number) FROM keyframes "
        "WHERE number > (SELECT coalesce(max(last), -1) FROM submaps)"
    ).fetchall()
    if first is not None:
        insert(connection, "submaps", [(_next(connection, "submaps"), first, last)])


def _map_in(connection: sqlite3.Connection, state: GraphState) -> GraphState:
    """Return a state without the keyframes that do not belong to the map."""
    graph = PoseGraph()
    read_constraints(connection, state, graph)
    kept = np.flatnonzero(graph.in_map())
    return replace(
        state,
        numbers=[state.numbers[k] for k in kept.tolist()],
        keyframes=[state.keyframes[k] for k in kept.tolist()],
        poses=state.poses[kept],
    )


def _next(connection: sqlite3.Connection, table: str) -> int:
    ((last,),) = connection.execute(f"SELECT coalesce(max(number), -1) FROM {table}").fetchall()
    return int(last) + 1


def _rollback_change(then: GraphState, now: GraphState, stamp_ns: int, reason: str) -> GraphChange:
    drawings = [draw_state(state, _COMPARED_M) for state in (now, then)]
    # Rows and columns of each drawing before the map's origin, and from there on.
    before = np.rint([drawing.frame.cells(0.0, 0.0)[::-1] for drawing in drawings]).astype(int)
    after = np.array([drawing.shape for drawing in drawings]) - before
    top, left = (-before.max(axis=0)).tolist()
    rows, columns = (before.max(axis=0) + after.max(axis=0)).tolist()
    old, new = (drawing.window(top, left, (rows, columns)) for drawing in drawings)
    return change_between(old, new, (top, left), _COMPARED_M, stamp_ns, reason, kind="rollback")
