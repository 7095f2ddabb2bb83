"""The visual map's file: SQLite, with every change and every piece of evidence kept."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from cairn.errors import CairnError
from cairn.files import replacing
from components.map_builder.objects import Change, Evidence, MapObject
from components.map_builder.rows import (
    change_row,
    evidence_row,
    object_from_row,
    object_row,
)

APPLICATION = 0x4361_726E  # "Carn", in the file's header
SCHEMA_VERSION = 1
LOCK_WAIT_S = 5.0

_LITTLE_SPACE = 256 * 1024  # bytes: SQLite's lock file and its log need so much
_DAMAGED = "It is damaged or no map: put back a copy of it, or import it again"

_SCHEMA = """
CREATE TABLE origin (source TEXT NOT NULL, digest TEXT NOT NULL, created_s REAL NOT NULL);
CREATE TABLE objects (
    object_id INTEGER PRIMARY KEY, name TEXT NOT NULL,
    x REAL, y REAL, xx REAL, xy REAL, yy REAL,
    reliability REAL NOT NULL, state INTEGER NOT NULL, evidence_count INTEGER NOT NULL,
    candidate_x REAL, candidate_y REAL, candidate_xx REAL, candidate_xy REAL, candidate_yy REAL,
    candidate_reliability REAL, candidate_sightings INTEGER
);
CREATE TABLE changes (
    version INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, object_id INTEGER NOT NULL,
    kind TEXT NOT NULL, old_x REAL, old_y REAL, new_x REAL, new_y REAL,
    reliability REAL NOT NULL, reason TEXT NOT NULL
);
CREATE TABLE evidence (
    stamp_ns INTEGER NOT NULL, object_id INTEGER NOT NULL,
    similarity REAL NOT NULL, verdict TEXT NOT NULL, distance REAL NOT NULL,
    x REAL NOT NULL, y REAL NOT NULL, xx REAL NOT NULL, xy REAL NOT NULL, yy REAL NOT NULL,
    robot_x REAL NOT NULL, robot_y REAL NOT NULL, robot_theta REAL NOT NULL,
    healthy INTEGER NOT NULL, counted INTEGER NOT NULL,
    reliability REAL NOT NULL, candidate_reliability REAL, state INTEGER NOT NULL
);
CREATE INDEX evidence_of_object ON evidence (object_id, stamp_ns);
"""


class MapFileError(CairnError):
    """A map file that is missing, foreign, damaged or cannot be written."""


@dataclass(frozen=True)
class Judged:
    """A piece of evidence, the object it left behind, and whether it counted."""

    stamp_ns: int
    evidence: Evidence
    after: MapObject
    counted: bool


class MapStore:
    """An open map file.

    What `commit` was told of is on the disk when it returns: it survives SIGKILL and loss of
    power. Evidence may be gathered and committed together; changes are to be committed at once.
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
        with _told(self.path):
            rows = self._connection.execute("SELECT * FROM objects ORDER BY object_id").fetchall()
            return list(map(object_from_row, rows))

    def version(self) -> int:
        """The number of changes made so far."""
        with _told(self.path):
            row = self._connection.execute("SELECT max(version) FROM changes").fetchone()
        return int(row[0] or 0)

    def last_stamp_ns(self) -> int:
        """The time of the newest evidence [ns]; 0 before the first."""
        with _told(self.path):
            row = self._connection.execute("SELECT max(stamp_ns) FROM evidence").fetchone()
        return int(row[0] or 0)

    def digest(self) -> str:
        """What identifies the map that this one was copied from; "" for an original."""
        with _told(self.path):
            row = self._connection.execute("SELECT digest FROM origin").fetchone()
        return str(row[0]) if row else ""

    def history(self) -> list[tuple[int, int, int, str, float, str]]:
        """All changes: version, stamp [ns], object, kind, reliability, reason."""
        with _told(self.path):
            return self._connection.execute(
                "SELECT version, stamp_ns, object_id, kind, reliability, reason "
                "FROM changes ORDER BY version"
            ).fetchall()

    def reliability_over_time(self, object_id: int) -> list[tuple[int, float]]:
        """Times [ns] and reliabilities of an object after each piece of evidence."""
        with _told(self.path):
            return self._connection.execute(
                "SELECT stamp_ns, reliability FROM evidence WHERE object_id = ? ORDER BY rowid",
                (object_id,),
            ).fetchall()

    def commit(
        self,
        objects: Sequence[MapObject],
        judged: Sequence[Judged] = (),
        changes: Sequence[tuple[int, int, Change]] = (),
    ) -> None:
        """Write objects, evidence and changes (version, stamp [ns], change), all or nothing."""
        with _told(self.path), self._connection as transaction:
            transaction.execute("BEGIN IMMEDIATE")
            transaction.executemany(
                f"INSERT OR REPLACE INTO objects VALUES ({_marks(17)})", map(object_row, objects)
            )
            transaction.executemany(
                f"INSERT INTO evidence VALUES ({_marks(18)})",
                (evidence_row(j.stamp_ns, j.evidence, j.after, j.counted) for j in judged),
            )
            transaction.executemany(
                f"INSERT INTO changes VALUES ({_marks(10)})",
                (change_row(version, stamp_ns, change) for version, stamp_ns, change in changes),
            )


def create_map(path: Path, source: str, digest: str = "") -> MapStore:
    """Make a new, empty map file; `source` says in words where the map comes from."""
    if path.exists():
        raise MapFileError(f"{path} exists already. Remove it or give another name.")
    with _told(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        connection.executescript(
            f"BEGIN; {_SCHEMA} PRAGMA application_id = {APPLICATION}; "
            f"PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;"
        )
        connection.execute("INSERT INTO origin VALUES (?, ?, ?)", (source, digest, time.time()))
    return MapStore(path, connection)


def open_map(path: Path, *, read_only: bool = False) -> MapStore:
    """Open a map file; `MapFileError` names the file, what is wrong with it and the remedy."""
    if not path.is_file():
        raise MapFileError(
            f"{path}: no such map file. Make one with `cairn map import`, or correct the path."
        )
    with _told(path):
        connection = _connect(path, read_only)
        try:
            _check(path, connection)
            if not read_only:
                # WAL: a reader never stops the robot, and a commit is one append and one fsync.
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = FULL")
                connection.execute("BEGIN IMMEDIATE")
                connection.execute("ROLLBACK")
        except BaseException:
            connection.close()
            raise
    return MapStore(path, connection)


def copy_map(original: Path, copy: Path) -> None:
    """Copy a map (which may stand in a read-only place) to `copy`, whole or not at all."""
    with open_map(original, read_only=True) as source, _told(copy):
        copy.parent.mkdir(parents=True, exist_ok=True)
        for stale in (copy, *_companions(copy)):
            stale.unlink(missing_ok=True)
        with (
            replacing(copy) as part,
            closing(sqlite3.connect(part, isolation_level=None)) as target,
        ):
            source._connection.backup(target)
            target.execute("UPDATE origin SET digest = ?", (digest_of(original),))


def digest_of(path: Path) -> str:
    """What identifies the content of a map file."""
    with _told(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()


def _connect(path: Path, read_only: bool) -> sqlite3.Connection:
    # A component's calls come one at a time, but not always on the same thread.
    if not read_only:
        return sqlite3.connect(
            path, isolation_level=None, timeout=LOCK_WAIT_S, check_same_thread=False
        )
    # A map at rest may stand where SQLite cannot make its lock files.
    at_rest = not any(companion.exists() for companion in _companions(path))
    mode = "immutable=1" if at_rest else "mode=ro"
    uri = f"{path.resolve().as_uri()}?{mode}"
    return sqlite3.connect(
        uri, uri=True, isolation_level=None, timeout=LOCK_WAIT_S, check_same_thread=False
    )


def _companions(path: Path) -> list[Path]:
    return [path.with_name(path.name + suffix) for suffix in ("-wal", "-shm", "-journal")]


def _check(path: Path, connection: sqlite3.Connection) -> None:
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if application != APPLICATION:
        raise MapFileError(
            f"{path} is not a visual map of Cairn. Give the file that `cairn map import` wrote."
        )
    if version != SCHEMA_VERSION:
        raise MapFileError(
            f"{path} has format {version}, this Cairn reads format {SCHEMA_VERSION}. Import the "
            "map again, or run the Cairn that wrote it."
        )
    damage = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if damage == "ok" and _columns(connection) != _columns_of_format():
        damage = "its tables are not those of a visual map"
    if damage != "ok":
        raise MapFileError(f"{path}: {damage}. {_DAMAGED}.")


def _columns_of_format() -> list[tuple[str, str, str]]:
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(_SCHEMA)
        return _columns(connection)


def _columns(connection: sqlite3.Connection) -> list[tuple[str, str, str]]:
    """Table, name and type of every column."""
    return connection.execute(
        "SELECT tables.name, columns.name, columns.type FROM sqlite_schema AS tables, "
        "pragma_table_info(tables.name) AS columns WHERE tables.type = 'table' "
        "ORDER BY tables.name, columns.cid"
    ).fetchall()


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn what SQLite and the file system raise into sentences that name file and remedy."""
    try:
        yield
    except sqlite3.Error as error:
        raise MapFileError(f"{path}: {error}. {_remedy(path, error)}.") from error
    except ValueError as error:  # of a row, or of bytes that are no text
        raise MapFileError(f"{path}: {error}. {_DAMAGED}.") from error
    except OSError as error:
        raise MapFileError(
            f"{error.filename or path}: {error.strerror or error}. Correct the path, its "
            "permissions or the space on its disk."
        ) from error


def _remedy(path: Path, error: sqlite3.Error) -> str:
    text = str(error)
    # On a full disk SQLite may as well fail at its lock files, with an I/O error.
    failed = "disk I/O error" in text or "unable to open" in text
    if "full" in text or (failed and _is_full(path.parent)):
        return "The disk is full: free some space on it"
    if "disk I/O error" in text:
        return "The disk fails: look into the system's log, and copy the file before all else"
    if "readonly" in text or "unable to open" in text:
        return (
            "It, or its folder, cannot be written: give it write permission, or set the "
            "parameter working_copy to a path that can be written"
        )
    if "locked" in text:
        return "Another program writes to it: stop that program"
    return _DAMAGED


def _is_full(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < _LITTLE_SPACE
    except OSError:
        return False


def _marks(count: int) -> str:
    return ", ".join("?" * count)
