"""The visual map's file (SQLite): its tables, formats and checksums; opens, upgrades, copies it.

Two programs use it: the object recognizer reads object models (`object_models.py`), the map builder
reads and writes landmarks, evidence and changes (`landmark_store.py`).
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from cairn.errors import CairnError
from cairn.limits.files import too_large
from cairn.limits.sqlite import bound_connection, replaced_by_copy
from cairn.system.files import TAKES_NO_DATA, complete_replacement, explain_os_error, side_files
from cairn.visual_map.shared_record import MOST_ROBOTS

APPLICATION: Final = 0x4361_726E
"""SQLite's application id of a visual map, in the file's header: "Carn"."""

LOCK_WAIT_S: Final = 5.0
"""How long a writer waits for another one [s]."""

MOST_ID: Final = 2**32 - 1
"""Largest identifier or count that a message can carry (uint32)."""

# Columns are listed in the order in which they are read. The last format adds columns at the end of
# a table, so the same statements create new files and upgrade existing ones.

_LANDMARKS: Final = (
    "CREATE TABLE origin (source TEXT NOT NULL, digest TEXT NOT NULL, created_s REAL NOT NULL)",
    """CREATE TABLE objects (
        object_id INTEGER PRIMARY KEY, name TEXT NOT NULL,
        x REAL, y REAL, xx REAL, xy REAL, yy REAL,
        reliability REAL NOT NULL, state INTEGER NOT NULL, evidence_count INTEGER NOT NULL,
        candidate_x REAL, candidate_y REAL,
        candidate_xx REAL, candidate_xy REAL, candidate_yy REAL,
        candidate_reliability REAL, candidate_sightings INTEGER
    )""",
    """CREATE TABLE changes (
        version INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, object_id INTEGER NOT NULL,
        kind TEXT NOT NULL, old_x REAL, old_y REAL, new_x REAL, new_y REAL,
        reliability REAL NOT NULL, reason TEXT NOT NULL
    )""",
    """CREATE TABLE evidence (
        stamp_ns INTEGER NOT NULL, object_id INTEGER NOT NULL,
        similarity REAL NOT NULL, verdict TEXT NOT NULL, distance REAL NOT NULL,
        x REAL NOT NULL, y REAL NOT NULL, xx REAL NOT NULL, xy REAL NOT NULL, yy REAL NOT NULL,
        robot_x REAL NOT NULL, robot_y REAL NOT NULL, robot_theta REAL NOT NULL,
        healthy INTEGER NOT NULL, counted INTEGER NOT NULL,
        reliability REAL NOT NULL, candidate_reliability REAL, state INTEGER NOT NULL
    )""",
    "CREATE INDEX evidence_of_object ON evidence (object_id, stamp_ns)",
)

# AUTOINCREMENT: identifiers are never reused, otherwise a new object would be mistaken for a
# removed one. `taught_changes` has one row; readers compare it to see whether to read again.
_OBJECT_MODELS: Final = (
    """CREATE TABLE taught_objects (
        object_id INTEGER PRIMARY KEY AUTOINCREMENT, name TEXT NOT NULL UNIQUE,
        width_m REAL, height_m REAL
    )""",
    """CREATE TABLE taught_views (
        view_id INTEGER PRIMARY KEY AUTOINCREMENT, object_id INTEGER NOT NULL,
        width INTEGER NOT NULL, height INTEGER NOT NULL,
        points BLOB NOT NULL, scales BLOB NOT NULL, angles BLOB NOT NULL,
        descriptors BLOB NOT NULL, picture BLOB NOT NULL
    )""",
    "CREATE INDEX views_of_object ON taught_views (object_id, view_id)",
    "CREATE TABLE taught_changes (number INTEGER NOT NULL)",
    "INSERT INTO taught_changes VALUES (0)",
)

# The viewpoints from which an object is usually recognized: JSON, "" if none is known.
_VIEWPOINTS: Final = ("ALTER TABLE objects ADD COLUMN viewpoints TEXT NOT NULL DEFAULT ''",)

# Checksums of rows (`row_checksum`). The checksum of a view does not cover its picture: that is a
# PNG with checksums of its own, and is not always read.
_CHECKSUMS: Final = (
    "ALTER TABLE objects ADD COLUMN checksum INTEGER",
    "ALTER TABLE taught_views ADD COLUMN checksum INTEGER",
)

# What is left of old evidence (`evidence_history.py`).
_SUMMARIES: Final = (
    """CREATE TABLE evidence_summaries (
        object_id INTEGER NOT NULL, verdict TEXT NOT NULL, counted INTEGER NOT NULL,
        pieces INTEGER NOT NULL, first_ns INTEGER NOT NULL, last_ns INTEGER NOT NULL,
        reliability REAL NOT NULL, PRIMARY KEY (object_id, verdict, counted)
    )""",
)

# From this format on, a row without a checksum is damaged; the upgrade adds those that are missing.
_ALL_CHECKSUMS: Final[tuple[str, ...]] = ()

# What this robot and others know about the landmarks (`shared_record.py`).
_CONTRIBUTIONS: Final = (
    """CREATE TABLE contributions (
        robot TEXT NOT NULL, object_id INTEGER NOT NULL, version INTEGER NOT NULL,
        stamp_ns INTEGER NOT NULL, began_ns INTEGER NOT NULL, began_by TEXT NOT NULL,
        x REAL, y REAL, xx REAL, xy REAL, yy REAL,
        removed INTEGER NOT NULL, log_odds REAL NOT NULL,
        information_xx REAL NOT NULL, information_xy REAL NOT NULL, information_yy REAL NOT NULL,
        information_x REAL NOT NULL, information_y REAL NOT NULL,
        checksum INTEGER NOT NULL, PRIMARY KEY (robot, object_id)
    )""",
)

FORMATS: Final[tuple[tuple[str, ...], ...]] = (
    _LANDMARKS,
    _OBJECT_MODELS + _VIEWPOINTS,
    _CHECKSUMS,
    _SUMMARIES,
    _ALL_CHECKSUMS,
    _CONTRIBUTIONS,
)
"""The statements that each format adds to the one before, the first one to an empty file."""

_CHECKED_COLUMNS: Final = {
    "objects": "object_id, name, x, y, xx, xy, yy, reliability, state, evidence_count, "
    "candidate_x, candidate_y, candidate_xx, candidate_xy, candidate_yy, candidate_reliability, "
    "candidate_sightings, viewpoints",
    "taught_views": "object_id, width, height, points, scales, angles, descriptors",
}
"""The columns that the checksum of a row covers, in order."""

MOST_OBJECTS: Final = 20_000
"""Most landmarks, and most object models, of a map."""

MAP_BYTES: Final = 1_000_000_000
"""Largest map file [bytes]."""

_LONGEST_VALUE: Final = 64_000_000  # the picture of a view
_LONGEST_TEXT: Final = 1_000
_BOUNDS: Final[dict[str, tuple[int, dict[str, int]]]] = {
    "origin": (1, {"source": 10_000, "digest": _LONGEST_TEXT}),
    "objects": (MOST_OBJECTS, {"name": _LONGEST_TEXT, "viewpoints": 100_000}),
    "changes": (5_000_000, {"kind": _LONGEST_TEXT, "reason": _LONGEST_TEXT}),
    "evidence": (5_000_000, {"verdict": _LONGEST_TEXT}),
    "evidence_summaries": (10 * MOST_OBJECTS, {"verdict": _LONGEST_TEXT}),
    "contributions": (
        MOST_ROBOTS * MOST_OBJECTS,
        {"robot": _LONGEST_TEXT, "began_by": _LONGEST_TEXT},
    ),
    "taught_objects": (MOST_OBJECTS, {"name": _LONGEST_TEXT}),
    "taught_views": (100_000, {}),
    "taught_changes": (1, {}),
}
"""Most rows of each table, and the longest texts in its columns [characters]."""

_MOST_VIEWPOINTS: Final = 20_000_000  # characters of all landmarks together
_STEPS: Final = 500_000_000  # of SQLite, to check a map of the largest size

_FORMAT: Final = len(FORMATS)
_EVIDENCE_OF_LANDMARK: Final = 200_000
"""Size of as many rows of evidence about one landmark as are kept (`evidence_history.py`)."""
_MOST_RESERVED: Final = 12_000_000
_LITTLE_SPACE: Final = 256 * 1024  # bytes: SQLite's lock file and log need as much
_DAMAGED: Final = "It is damaged or not a map: restore a copy of it, or import it again"


class MapFileError(CairnError):
    """A map file is missing, foreign, damaged or cannot be written."""


class DamagedMap(MapFileError):
    """The content of a map file is damaged, or not that of a map."""


class MapNotWritable(MapFileError):
    """The disk of a map file takes no data now: full, over quota, at a size limit, read-only."""


def create(
    path: Path, source: str, digest: str = "", created_s: float | None = None
) -> sqlite3.Connection:
    """Make a new, empty map file; `source` says in words where the map comes from.

    `created_s` is the time of creation in the file [s since 1970], None: the system's.
    Raises `MapFileError` if the file exists or cannot be made.
    """
    if path.exists():
        raise MapFileError(f"{path} exists already. Remove it or give another name.")
    with explained_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(exist_ok=False)  # SQLite does not say why a file cannot be made
        with _on_error(partial(path.unlink, missing_ok=True)):
            connection = _connection(path)
            with _on_error(connection.close):
                connection.execute("BEGIN IMMEDIATE")
                _add_formats(connection, since=0)
                connection.execute(f"PRAGMA application_id = {APPLICATION}")
                origin = (source, digest, time.time() if created_s is None else created_s)
                connection.execute("INSERT INTO origin VALUES (?, ?, ?)", origin)
                connection.execute("COMMIT")
    return connection


def connect(path: Path, *, read_only: bool = False) -> sqlite3.Connection:
    """Open and check a map file, in autocommit mode.

    A file of an older format is upgraded; if `read_only`, a copy of it in memory is. Raises
    `MapFileError`, which names the file, the defect and the remedy.
    """
    _check_exists(path)
    with explained_errors(path):
        connection = _readable_connection(path) if read_only else _connection(path)
        with _on_error(connection.close):
            bound_connection(connection, longest=_LONGEST_VALUE, steps=_STEPS)
            version = _checked_format(path, connection)
            _check_content(path, connection)
            if version < _FORMAT:
                if read_only:
                    connection = _in_memory(connection)
                _upgrade(connection)
            connection.set_progress_handler(None, 0)
            if not read_only:
                # WAL: readers never block the robot, and a commit is one append and one fsync.
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = FULL")
                connection.execute("BEGIN IMMEDIATE")
                connection.execute("ROLLBACK")
    return connection


def copy_map(original: Path, copy: Path) -> None:
    """Copy a map, also from a read-only place, to `copy`, completely or not at all."""
    with (
        closing(connect(original, read_only=True)) as source,
        explained_errors(copy),
        replaced_by_copy(source, copy) as target,
    ):
        target.execute("UPDATE origin SET digest = ?", (_digest(source),))
        _reserve_evidence(target)


def _reserve_evidence(connection: sqlite3.Connection) -> None:
    """Make room in a file for the evidence about its landmarks, if the disk has so much.

    So the file does not grow for hours, and a disk that becomes full does not delay the evidence.
    """
    landmarks = connection.execute("SELECT count(*) FROM objects").fetchone()[0]
    size = min(landmarks * _EVIDENCE_OF_LANDMARK, _MOST_RESERVED)
    with suppress(sqlite3.Error):  # no room
        connection.execute("BEGIN IMMEDIATE")
        try:
            connection.execute("CREATE TABLE reserve (room BLOB)")
            connection.execute("INSERT INTO reserve VALUES (zeroblob(?))", (size,))
            connection.execute("DROP TABLE reserve")  # its pages stay in the file, free
            connection.execute("COMMIT")
        except sqlite3.Error:
            connection.execute("ROLLBACK")


def digest_of(path: Path) -> str:
    """Return a digest that identifies the map in a file; it does not depend on object models.

    Raises `MapFileError` if the file cannot be read.
    """
    with closing(connect(path, read_only=True)) as connection, explained_errors(path):
        return _digest(connection)


@contextmanager
def connect_unchecked(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a file of any format for a short read: its content is not checked, only its schema.

    Raises errors as `connect`.
    """
    _check_exists(path)
    with explained_errors(path), closing(_connection(path, read_only=True)) as connection:
        bound_connection(connection, longest=_LONGEST_VALUE, steps=_STEPS)
        _checked_format(path, connection)
        yield connection


def at_rest(path: Path) -> bool:
    """Return whether no program has the file open for writing."""
    return not any(file.exists() for file in side_files(path))


@contextmanager
def explained_errors(path: Path) -> Iterator[None]:
    """Turn errors of SQLite and the file system into `MapFileError` with file and remedy."""
    try:
        yield
    except sqlite3.Error as error:
        refused = _writing_error(path.parent) if _is_of_the_disk(error) else None
        why = _remedy(error) if refused is None else explain_os_error(refused, path)
        kind = MapFileError
        if refused is not None or getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_FULL:
            kind = MapNotWritable
        elif why == _DAMAGED:
            kind = DamagedMap
        raise kind(f"{path}: {error}. {why}.") from error
    except ValueError as error:  # an invalid row, or bytes that are not text
        raise DamagedMap(f"{path}: {error}. {_DAMAGED}.") from error
    except OSError as error:
        kind = MapNotWritable if error.errno in TAKES_NO_DATA else MapFileError
        raise kind(f"{error.filename or path}: {explain_os_error(error, path)}.") from error


@contextmanager
def transaction(path: Path, connection: sqlite3.Connection) -> Iterator[sqlite3.Connection]:
    """Write everything that is executed, or nothing; wait for other writers.

    Raises `MapFileError` if it cannot be written, or if another program has written for 5 s.
    """
    with explained_errors(path), connection:
        connection.execute("BEGIN IMMEDIATE")
        yield connection


def row_checksum(values: Iterable[Any]) -> int:
    """Return the CRC-32 of a row of numbers, texts and bytes.

    SQLite detects damage of its own structure, but not of the values.
    """
    total = 0
    for value in values:
        total = zlib.crc32(_bytes(value), zlib.crc32(b"|", total))
    return total


def check_row(values: Iterable[Any], stored: Any) -> None:
    """Raise `ValueError` if a row does not match its `stored` checksum."""
    if stored is None:
        raise ValueError("its checksum is missing")
    if stored != row_checksum(values):
        raise ValueError("its content has changed since it was written: the checksum differs")


def _bytes(value: Any) -> bytes:
    if isinstance(value, bytes):
        return value
    if isinstance(value, int | float):
        # SQLite returns whole numbers in the type of the column, and no minus before 0.
        value = float(value) + 0.0
    return repr(value).encode()


def _check_exists(path: Path) -> None:
    complete_replacement(path)
    with explained_errors(path):
        if path.is_file():
            if path.stat().st_size > MAP_BYTES:
                raise too_large(path, path.stat().st_size, MAP_BYTES)
            return
        if path.is_dir():
            raise DamagedMap(f"{path} is a folder. Give a map file, such as one in it.")
        if path.exists():
            raise DamagedMap(f"{path} is not a regular file. Give a map file.")
    raise MapFileError(
        f"{path}: no such map file. Make one with `cairn map import` or `cairn object teach`, "
        "or correct the path."
    )


def _connection(path: Path, read_only: bool = False) -> sqlite3.Connection:
    # A map at rest may be in a folder where SQLite cannot make its lock files.
    mode = "mode=rwc" if not read_only else "immutable=1" if at_rest(path) else "mode=ro"
    # A component's handlers run one at a time, but not always on the same thread.
    return sqlite3.connect(
        f"{path.resolve().as_uri()}?{mode}",
        uri=True,
        isolation_level=None,
        timeout=LOCK_WAIT_S,
        check_same_thread=False,
    )


def _readable_connection(path: Path) -> sqlite3.Connection:
    """Open a file for reading, also on a full disk after a process that wrote it was killed."""
    connection = _connection(path, read_only=True)
    with _on_error(connection.close):
        try:
            connection.execute("PRAGMA schema_version")
            return connection
        except sqlite3.OperationalError:
            if at_rest(path) or _writing_error(path.parent) is None:
                raise
    connection.close()
    # SQLite cannot make the lock file beside the log. In exclusive mode it needs none.
    connection = sqlite3.connect(path, isolation_level=None, timeout=LOCK_WAIT_S)
    with _on_error(connection.close):
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        return _in_memory(connection)


@contextmanager
def _on_error(undo: Callable[[], object]) -> Iterator[None]:
    try:
        yield
    except BaseException:
        undo()
        raise


def _checked_format(path: Path, connection: sqlite3.Connection) -> int:
    """Return the format of a map after checking that its schema is exactly that of the format."""
    connection.execute("BEGIN")  # so that no other program upgrades it meanwhile
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    if application != APPLICATION:
        raise DamagedMap(
            f"{path} is not a visual map of Cairn. Give a file that `cairn map import` or `cairn "
            "object teach` wrote."
        )
    version = _format(connection)
    if not 1 <= version <= _FORMAT:
        raise DamagedMap(
            f"{path} has format {version}, this Cairn reads formats up to {_FORMAT}. Import the "
            "map again, or run the Cairn that wrote it."
        )
    fault = _fault_of_schema(_schema(connection), version)
    connection.execute("COMMIT")
    if fault:
        raise DamagedMap(f"{path} is not a visual map of format {version}: {fault}. {_DAMAGED}.")
    return version


Schema = dict[tuple[str, str], str]
"""The SQL of each table, index, trigger and view, by kind and name."""


def _schema(connection: sqlite3.Connection) -> Schema:
    rows = connection.execute(
        "SELECT type, substr(name, 1, 100), substr(coalesce(sql, ''), 1, 2000) FROM sqlite_schema "
        "WHERE name NOT LIKE 'sqlite\\_stat%' ESCAPE '\\' LIMIT 100"
    ).fetchall()
    return {(kind, name): " ".join(sql.split()) for kind, name, sql in rows}


@cache
def _schema_of(version: int) -> Schema:
    """Return the schema of a file of a format."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as model:
        for statements in FORMATS[:version]:
            for statement in statements:
                model.execute(statement)
        return _schema(model)


def _fault_of_schema(found: Schema, version: int) -> str:
    """Return how a schema differs from that of a format, "" if it does not."""
    wanted = _schema_of(version)
    for kind, name in sorted(found.keys() - wanted.keys()):
        return f"it has the {kind} {name!r}"
    for kind, name in sorted(wanted.keys() - found.keys()):
        return f"it has no {kind} {name!r}"
    return next(
        (f"its {k} {n!r} is another one" for k, n in wanted if wanted[k, n] != found[k, n]), ""
    )


def _check_content(path: Path, connection: sqlite3.Connection) -> None:
    """Raise `MapFileError` if a map is damaged, or has more or longer values than Cairn writes."""
    damage = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if damage != "ok":
        raise DamagedMap(f"{path}: {' '.join(damage.split())}. {_DAMAGED}.")
    tables = {name for kind, name in _schema(connection) if kind == "table"}
    for table, (most, texts) in _BOUNDS.items():
        if table not in tables:
            continue  # of a later format
        columns = {name for of, name, _ in _columns(connection) if of == table}
        count = connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        if count > most:
            raise DamagedMap(
                f"{path}: its table {table} has {count:,} rows, more than the {most:,} that are "
                f"allowed. {_DAMAGED}."
            )
        for column, longest in texts.items():
            if column not in columns:
                continue
            held, total = connection.execute(
                f"SELECT max(length({column})), total(length({column})) FROM {table}"
            ).fetchone()
            if (held or 0) > longest or (column == "viewpoints" and total > _MOST_VIEWPOINTS):
                raise DamagedMap(
                    f"{path}: the column {column} of its table {table} has a text of {held:,} "
                    f"characters, and {total:,.0f} together, more than is allowed. {_DAMAGED}."
                )


def _format(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _upgrade(connection: sqlite3.Connection) -> None:
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        # Read the format again: another program may have upgraded the file meanwhile.
        since = _format(connection)
        _add_formats(connection, since)
        if since < _FORMAT:
            _add_checksums(connection)


def _add_checksums(connection: sqlite3.Connection) -> None:
    """Add the checksums of rows that programs of older formats wrote without."""
    for table, columns in _CHECKED_COLUMNS.items():
        missing = connection.execute(f"SELECT rowid FROM {table} WHERE checksum IS NULL").fetchall()
        for key in missing:
            row = connection.execute(f"SELECT {columns} FROM {table} WHERE rowid = ?", key)
            connection.execute(
                f"UPDATE {table} SET checksum = ? WHERE rowid = ?",
                (row_checksum(row.fetchone()), *key),
            )


def _add_formats(connection: sqlite3.Connection, since: int) -> None:
    for statements in FORMATS[since:]:
        for statement in statements:
            connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {_FORMAT}")


def _in_memory(file: sqlite3.Connection) -> sqlite3.Connection:
    memory = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    bound_connection(memory, longest=_LONGEST_VALUE)
    with closing(file):
        file.backup(memory)
    return memory


def _columns(connection: sqlite3.Connection) -> list[tuple[str, str, str]]:
    """Return table, name and type of every column."""
    return connection.execute(
        "SELECT tables.name, columns.name, columns.type FROM sqlite_schema AS tables, "
        "pragma_table_info(tables.name) AS columns WHERE tables.type = 'table' "
        "ORDER BY tables.name, columns.cid"
    ).fetchall()


def _digest(connection: sqlite3.Connection) -> str:
    digest = hashlib.sha256()
    columns = _columns(connection)
    for table in ("origin", "objects", "changes"):
        # Without checksums, so that copies that an older Cairn made still match.
        names = ", ".join(name for of, name, _ in columns if of == table and name != "checksum")
        for row in connection.execute(f"SELECT {names} FROM {table} ORDER BY rowid"):
            digest.update(repr(row).encode())
    return digest.hexdigest()


def _remedy(error: sqlite3.Error) -> str:
    text = str(error)
    if "full" in text:
        return "The disk is full: free some space on it"
    if "disk I/O error" in text:
        return "The disk fails: copy the file to another one first, then read the system's log"
    if "readonly" in text or "unable to open" in text:
        return (
            "The file or its folder is read-only: change its permissions, or use a copy (the map "
            "builder's parameter working_copy makes one)"
        )
    if "locked" in text:
        return "Another program is writing to it: stop that program"
    return _DAMAGED


def _is_of_the_disk(error: sqlite3.Error) -> bool:
    """Return whether an error may mean that the disk takes no data now."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in (
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_READONLY,
    )


def _writing_error(folder: Path) -> OSError | None:
    """Return why the disk of a folder takes no data now; None if it does, or for other reasons.

    SQLite does not report the system's error: on a full disk it also fails at its lock files.
    """
    try:
        with tempfile.TemporaryFile(dir=folder, buffering=0) as probe:
            written = 0
            while written < _LITTLE_SPACE:  # a write that does not fit at all fails
                written += os.write(probe.fileno(), bytes(_LITTLE_SPACE - written))
    except OSError as error:
        return error if error.errno in TAKES_NO_DATA else None
    return None
