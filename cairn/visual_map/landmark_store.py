"""Landmarks in the visual map's file: records, every change, every piece of evidence."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from cairn.planar.poses import Pose
from cairn.system.closing import Closing
from cairn.visual_map.evidence_history import EvidenceHistory, EvidenceSummary, Row
from cairn.visual_map.landmarks import (
    FARTHEST_M,
    NO_VIEWPOINTS,
    CandidatePosition,
    Cell,
    EvidenceVerdict,
    LandmarkChange,
    LandmarkEvidence,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
    Viewpoints,
)
from cairn.visual_map.shared_record import (
    Contribution,
    Life,
    PositionInformation,
    check_contribution,
)
from cairn.visual_map.sqlite_file import (
    MOST_ID,
    MapFileError,
    check_row,
    connect,
    create,
    explained_errors,
    row_checksum,
    transaction,
)

_MOST_READ: Final = 20_000  # pieces of evidence of one object; newer programs keep 1,200
# The robot's pose at the last observation of a candidate is not stored: the next observation counts
# as made from another pose.
_ELSEWHERE = (float("inf"), float("inf"), 0.0)


MOST_CHANGES: Final = 20_000
"""Newest changes of the map that the file keeps."""


@dataclass(frozen=True)
class StoredEvidence:
    """A stored piece of evidence, with the state of the landmark after it; [ns], [m], [rad]."""

    stamp_ns: int
    similarity: float
    verdict: EvidenceVerdict
    distance: float
    implied: tuple[float, float]
    robot: Pose
    healthy: bool
    counted: bool
    reliability: float
    candidate_reliability: float | None
    state: LandmarkState


@dataclass(frozen=True)
class StoredChange:
    """A stored change of the map; `new` is the position [m] after it, None if removed."""

    stamp_ns: int
    kind: str
    new: tuple[float, float] | None
    reliability: float
    reason: str


class LandmarkStore(Closing):
    """The landmarks of an open map file.

    Committed data are on the disk when `commit` returns: they survive SIGKILL and loss of power.
    Evidence may be gathered and committed together; changes must be committed at once.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """Use `open_landmarks` or `create_landmarks`."""
        self.path = path
        self._connection = connection
        self._evidence = EvidenceHistory(connection)

    def close(self) -> None:
        """Close the file; committed data are safe."""
        self._connection.close()

    def landmarks(self) -> list[LandmarkRecord]:
        """Return all landmarks as last committed."""
        with explained_errors(self.path):
            rows = self._connection.execute("SELECT * FROM objects ORDER BY object_id").fetchall()
            return list(map(landmark_from_row, rows))

    def version(self) -> int:
        """Return the number of changes made so far."""
        return int(self._first("SELECT max(version) FROM changes") or 0)

    def last_stamp_ns(self) -> int:
        """Return the time of the newest evidence [ns], 0 before the first."""
        return int(self._first("SELECT max(stamp_ns) FROM evidence") or 0)

    def digest(self) -> str:
        """Return the digest of the map that this one was copied from, "" for an original."""
        return str(self._first("SELECT digest FROM origin") or "")

    def _first(self, query: str) -> Any:
        with explained_errors(self.path):
            row = self._connection.execute(query).fetchone()
        return row[0] if row else None

    def history(self) -> list[tuple[int, int, int, str, float, str]]:
        """Return the changes: version, stamp [ns], object, kind, reliability, reason."""
        with explained_errors(self.path):
            rows = self._connection.execute(
                "SELECT version, stamp_ns, object_id, kind, reliability, reason "
                "FROM changes ORDER BY version DESC LIMIT ?",
                (MOST_CHANGES,),
            ).fetchall()
        return rows[::-1]

    def evidence_of(self, object_id: int) -> list[StoredEvidence]:
        """Return the newest stored evidence about an object, oldest first."""
        with explained_errors(self.path):
            rows = self._connection.execute(
                "SELECT stamp_ns, similarity, verdict, distance, x, y, robot_x, robot_y, "
                "robot_theta, healthy, counted, reliability, candidate_reliability, state "
                "FROM evidence WHERE object_id = ? ORDER BY rowid DESC LIMIT ?",
                (object_id, _MOST_READ),
            ).fetchall()
            return [_stored_evidence(row) for row in reversed(rows)]

    def evidence_summaries_of(self, object_id: int) -> list[EvidenceSummary]:
        """Return the summaries of older evidence about an object, which is not stored any more."""
        with explained_errors(self.path):
            return self._evidence.summaries_of(object_id)

    def changes_of(self, object_id: int) -> list[StoredChange]:
        """Return all changes of an object, oldest first."""
        with explained_errors(self.path):
            rows = self._connection.execute(
                "SELECT stamp_ns, kind, new_x, new_y, reliability, reason FROM changes "
                "WHERE object_id = ? ORDER BY version DESC LIMIT ?",
                (object_id, MOST_CHANGES),
            ).fetchall()
            return [
                StoredChange(stamp, kind, None if x is None else (x, y), reliability, reason)
                for stamp, kind, x, y, reliability, reason in reversed(rows)
            ]

    def contributions(self) -> list[Contribution]:
        """Return what all robots with this map have contributed, as last committed."""
        with explained_errors(self.path):
            rows = self._connection.execute(
                "SELECT * FROM contributions ORDER BY object_id, robot"
            ).fetchall()
            return list(map(_contribution_from_row, rows))

    def commit(
        self,
        landmarks: Sequence[LandmarkRecord],
        evidence: Sequence[Row] = (),
        changes: Sequence[tuple[int, int, LandmarkChange]] = (),
        summaries: Iterable[EvidenceSummary] = (),
        contributions: Mapping[int, Sequence[Contribution]] | None = None,
    ) -> None:
        """Write landmarks, evidence and changes (version, stamp [ns], change), all or nothing.

        `evidence` has rows of `evidence_row`; `summaries` are about older evidence without rows.
        `contributions` has all those about some objects; they replace the former ones.
        """
        try:
            with transaction(self.path, self._connection) as connection:
                connection.executemany(
                    f"INSERT OR REPLACE INTO objects VALUES ({_placeholders(19)})",
                    map(landmark_row, landmarks),
                )
                self._evidence.append(evidence, summaries)
                connection.executemany(
                    f"INSERT INTO changes VALUES ({_placeholders(10)})",
                    (change_row(version, stamp, change) for version, stamp, change in changes),
                )
                for object_id, known in (contributions or {}).items():
                    connection.execute(
                        "DELETE FROM contributions WHERE object_id = ?", (object_id,)
                    )
                    connection.executemany(
                        f"INSERT INTO contributions VALUES ({_placeholders(19)})",
                        map(_contribution_row, known),
                    )
                if changes:
                    oldest = changes[-1][0] - MOST_CHANGES
                    connection.execute("DELETE FROM changes WHERE version <= ?", (oldest,))
        except MapFileError:
            self._evidence.rolled_back()
            raise


def create_landmarks(path: Path, source: str, created_s: float | None = None) -> LandmarkStore:
    """Make a new, empty map file; `source` says in words where the map comes from.

    `created_s` is the time of creation in the file [s since 1970], None: the system's.
    """
    return LandmarkStore(path, create(path, source, created_s=created_s))


def open_landmarks(path: Path, *, read_only: bool = False) -> LandmarkStore:
    """Open a map file; raise `MapFileError` with the file, the defect and the remedy."""
    return LandmarkStore(path, connect(path, read_only=read_only))


def _stored_evidence(row: tuple[Any, ...]) -> StoredEvidence:
    stamp, similarity, verdict, distance, x, y, robot_x, robot_y, theta, *rest = row
    healthy, counted, reliability, candidate_reliability, state = rest
    try:
        return StoredEvidence(
            stamp_ns=int(stamp),
            similarity=float(similarity),
            verdict=EvidenceVerdict[verdict],
            distance=float(distance),
            implied=(float(x), float(y)),
            robot=(float(robot_x), float(robot_y), float(theta)),
            healthy=bool(healthy),
            counted=bool(counted),
            reliability=float(reliability),
            candidate_reliability=candidate_reliability,
            state=LandmarkState(state),
        )
    except (TypeError, KeyError, OverflowError) as error:
        raise ValueError(f"evidence at {stamp}: {error}") from error


def _placeholders(count: int) -> str:
    return ", ".join("?" * count)


def landmark_row(landmark: LandmarkRecord) -> Row:
    """Return the row of table `objects` for a landmark."""
    found = landmark.candidate
    row = (
        landmark.object_id,
        landmark.name,
        *_position_row(landmark.position),
        landmark.reliability,
        int(landmark.state),
        landmark.evidence_count,
        *_position_row(found.position if found else None),
        found.reliability if found else None,
        found.observations if found else None,
        json.dumps(asdict(landmark.viewpoints)),
    )
    return (*row, row_checksum(row))


def landmark_from_row(row: Row) -> LandmarkRecord:
    """Return the landmark of a row of table `objects`.

    Raises `ValueError` with the object and the value if the row is not valid.
    """
    try:
        candidate_position = _position(row[10:15])
        candidate = None
        if candidate_position is not None:
            observations = _within("candidate_sightings", int(row[16]), 0, MOST_ID)
            candidate = CandidatePosition(
                candidate_position, _probability(row[15]), observations, _ELSEWHERE
            )
        if "\0" in str(row[1]):
            raise ValueError("name contains a NUL")
        found = LandmarkRecord(
            object_id=_within("object_id", int(row[0]), 0, MOST_ID),
            name=str(row[1]),
            position=_position(row[2:7]),
            reliability=_probability(row[7]),
            state=LandmarkState(row[8]),
            evidence_count=_within("evidence_count", int(row[9]), 0, MOST_ID),
            candidate=candidate,
            viewpoints=_viewpoints(str(row[17])),
        )
        check_row(row[:18], row[18])
        return found
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise ValueError(f"object {row[0]}: {error}") from error


def change_row(version: int, stamp_ns: int, change: LandmarkChange) -> Row:
    """Return the row of table `changes`."""
    old, new = change.old, change.new
    return (
        version,
        stamp_ns,
        change.object_id,
        change.kind.name,
        old.x if old else None,
        old.y if old else None,
        new.x if new else None,
        new.y if new else None,
        change.reliability,
        change.reason,
    )


def evidence_row(
    stamp_ns: int, evidence: LandmarkEvidence, after: LandmarkRecord, counted: bool
) -> Row:
    """Return the row of table `evidence`: the observation, and the landmark after it."""
    return (
        stamp_ns,
        evidence.object_id,
        evidence.effective_similarity,
        evidence.verdict.name,
        evidence.distance,
        *_position_row(evidence.implied),
        *evidence.robot,
        int(evidence.healthy),
        int(counted),
        after.reliability,
        after.candidate.reliability if after.candidate else None,
        int(after.state),
    )


def _contribution_row(one: Contribution) -> Row:
    life, found = one.life, one.information
    row = (
        one.robot,
        one.object_id,
        one.version,
        one.stamp_ns,
        life.began_ns,
        life.robot,
        *_position_row(one.registered),
        int(one.removed),
        one.log_odds,
        found.xx,
        found.xy,
        found.yy,
        found.x,
        found.y,
    )
    return (*row, row_checksum(row))


def _contribution_from_row(row: Row) -> Contribution:
    try:
        one = Contribution(
            robot=str(row[0]),
            object_id=int(row[1]),
            version=int(row[2]),
            stamp_ns=int(row[3]),
            life=Life(int(row[4]), str(row[5])),
            registered=_position(row[6:11]),
            removed=bool(row[11]),
            log_odds=float(row[12]),
            information=PositionInformation(*map(float, row[13:18])),
        )
        check_contribution(one)
        check_row(row[:18], row[18])
        return one
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"contribution about object {row[1]}: {error}") from error


def _position_row(position: MapPosition | None) -> Row:
    if position is None:
        return (None,) * 5
    return position.x, position.y, position.xx, position.xy, position.yy


def _position(values: Row) -> MapPosition | None:
    if values[0] is None:
        return None
    position = MapPosition(*(float(value) for value in values))
    if not all(map(math.isfinite, (position.x, position.y, position.xx, position.xy, position.yy))):
        raise ValueError(f"its position has values that are not finite: {values}")
    if max(abs(position.x), abs(position.y)) > FARTHEST_M or max(position.xx, position.yy) > 1e14:
        raise ValueError(f"its position {values} is farther than {FARTHEST_M:g} m")
    if (
        position.xx < 0
        or position.yy < 0
        or position.xy**2 > position.xx * position.yy * (1 + 1e-9)
    ):
        raise ValueError(
            f"({position.xx}, {position.xy}, {position.yy}) is not a covariance of its position"
        )
    return position


def _viewpoints(text: str) -> Viewpoints:
    if not text:
        return NO_VIEWPOINTS
    held = json.loads(text)

    def counts(name: str) -> tuple[tuple[Cell, int], ...]:
        return tuple(
            (_cell(cell), _within(f"number of times {name}", int(count), 0, MOST_ID))
            for cell, count in held[name]
        )

    return Viewpoints(counts("seen"), counts("missed"), tuple(map(_cell, held["absent"])))


def _cell(pair: Any) -> Cell:
    sector, band = pair
    return int(sector), int(band)


def _probability(value: Any) -> float:
    number = float(value)
    if not 0.0 <= number <= 1.0:
        raise ValueError(f"its reliability {number} is not between 0 and 1")
    return number


def _within(name: str, number: int, low: int, high: int) -> int:
    if not low <= number <= high:
        raise ValueError(f"its {name} {number} is not from {low} to {high}")
    return number
