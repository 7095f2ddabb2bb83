"""What the visual map's file holds of the map: objects, every change, every piece of evidence."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from cairn.components.map_builder.objects import Change, Evidence, MapObject, State, Verdict
from cairn.components.map_builder.rows import (
    change_row,
    evidence_row,
    object_from_row,
    object_row,
)
from cairn.planar.poses import Pose
from cairn.visual_map.file import connect, create, explained_errors, transaction


@dataclass(frozen=True)
class Judged:
    """A piece of evidence, the object it left behind, and whether it counted."""

    stamp_ns: int
    evidence: Evidence
    after: MapObject
    counted: bool


@dataclass(frozen=True)
class KeptEvidence:
    """A piece of evidence as it is kept, with what it left of the object; [ns], [m], [rad]."""

    stamp_ns: int
    similarity: float
    verdict: Verdict
    distance: float
    implied: tuple[float, float]
    robot: Pose
    healthy: bool
    counted: bool
    reliability: float
    candidate_reliability: float | None
    state: State


@dataclass(frozen=True)
class KeptChange:
    """A change of the map as it is kept; `new` is the place [m] after it, None if there is none."""

    stamp_ns: int
    kind: str
    new: tuple[float, float] | None
    reliability: float
    reason: str


class MapStore:
    """An open map file.

    Committed data are on the disk when `commit` returns: they survive SIGKILL and loss of power.
    Evidence may be gathered and committed together; changes must be committed at once.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """Use `open_map` or `create_map`."""
        self.path = path
        self._connection = connection

    def __enter__(self) -> MapStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; nothing that was committed is lost."""
        self._connection.close()

    def objects(self) -> list[MapObject]:
        """All objects as last committed."""
        with explained_errors(self.path):
            rows = self._connection.execute("SELECT * FROM objects ORDER BY object_id").fetchall()
            return list(map(object_from_row, rows))

    def version(self) -> int:
        """The number of changes made so far."""
        with explained_errors(self.path):
            row = self._connection.execute("SELECT max(version) FROM changes").fetchone()
        return int(row[0] or 0)

    def last_stamp_ns(self) -> int:
        """The time of the newest evidence [ns]; 0 before the first."""
        with explained_errors(self.path):
            row = self._connection.execute("SELECT max(stamp_ns) FROM evidence").fetchone()
        return int(row[0] or 0)

    def digest(self) -> str:
        """What identifies the map that this one was copied from; "" for an original."""
        with explained_errors(self.path):
            row = self._connection.execute("SELECT digest FROM origin").fetchone()
        return str(row[0]) if row else ""

    def history(self) -> list[tuple[int, int, int, str, float, str]]:
        """All changes: version, stamp [ns], object, kind, reliability, reason."""
        with explained_errors(self.path):
            return self._connection.execute(
                "SELECT version, stamp_ns, object_id, kind, reliability, reason "
                "FROM changes ORDER BY version"
            ).fetchall()

    def evidence_of(self, object_id: int) -> list[KeptEvidence]:
        """All evidence for and against an object, the oldest first."""
        with explained_errors(self.path):
            rows = self._connection.execute(
                "SELECT stamp_ns, similarity, verdict, distance, x, y, robot_x, robot_y, "
                "robot_theta, healthy, counted, reliability, candidate_reliability, state "
                "FROM evidence WHERE object_id = ? ORDER BY rowid",
                (object_id,),
            ).fetchall()
            return [_kept(row) for row in rows]

    def changes_of(self, object_id: int) -> list[KeptChange]:
        """All changes of the map that were made to an object, the oldest first."""
        with explained_errors(self.path):
            rows = self._connection.execute(
                "SELECT stamp_ns, kind, new_x, new_y, reliability, reason FROM changes "
                "WHERE object_id = ? ORDER BY version",
                (object_id,),
            ).fetchall()
            return [
                KeptChange(stamp, kind, None if x is None else (x, y), reliability, reason)
                for stamp, kind, x, y, reliability, reason in rows
            ]

    def commit(
        self,
        objects: Sequence[MapObject],
        judged: Sequence[Judged] = (),
        changes: Sequence[tuple[int, int, Change]] = (),
    ) -> None:
        """Write objects, evidence and changes (version, stamp [ns], change), all or nothing."""
        with transaction(self.path, self._connection) as connection:
            connection.executemany(
                f"INSERT OR REPLACE INTO objects VALUES ({_marks(19)})", map(object_row, objects)
            )
            connection.executemany(
                f"INSERT INTO evidence VALUES ({_marks(18)})",
                (evidence_row(j.stamp_ns, j.evidence, j.after, j.counted) for j in judged),
            )
            connection.executemany(
                f"INSERT INTO changes VALUES ({_marks(10)})",
                (change_row(version, stamp_ns, change) for version, stamp_ns, change in changes),
            )


def create_map(path: Path, source: str) -> MapStore:
    """Make a new, empty map file; `source` says in words where the map comes from."""
    return MapStore(path, create(path, source))


def open_map(path: Path, *, read_only: bool = False) -> MapStore:
    """Open a map file; `MapFileError` names the file, what is wrong with it and the remedy."""
    return MapStore(path, connect(path, read_only=read_only))


def _kept(row: tuple[Any, ...]) -> KeptEvidence:
    stamp, similarity, verdict, distance, x, y, robot_x, robot_y, theta, *rest = row
    healthy, counted, reliability, candidate_reliability, state = rest
    try:
        return KeptEvidence(
            stamp_ns=int(stamp),
            similarity=float(similarity),
            verdict=Verdict[verdict],
            distance=float(distance),
            implied=(float(x), float(y)),
            robot=(float(robot_x), float(robot_y), float(theta)),
            healthy=bool(healthy),
            counted=bool(counted),
            reliability=float(reliability),
            candidate_reliability=candidate_reliability,
            state=State(state),
        )
    except (TypeError, KeyError) as error:
        raise ValueError(f"evidence at {stamp}: {error}") from error


def _marks(count: int) -> str:
    return ", ".join("?" * count)
