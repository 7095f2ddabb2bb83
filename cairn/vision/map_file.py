"""The visual map's file: SQLite; made, opened, checked, brought up to date and copied."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from cairn.errors import CairnError
from cairn.files import replacing
from cairn.vision.file_errors import why
from cairn.vision.map_schema import FORMATS

APPLICATION = 0x4361_726E  # "Carn", in the file's header
LOCK_WAIT_S = 5.0

_FORMAT = len(FORMATS)
_LITTLE_SPACE = 256 * 1024  # bytes: SQLite's lock file and its log need so much
_DAMAGED = "It is damaged or no map: put back a copy of it, or import it again"


class MapFileError(CairnError):
    """A map file that is missing, foreign, damaged or cannot be written."""


def create(path: Path, source: str, digest: str = "") -> sqlite3.Connection:
    """Make a new map file without objects; `source` says in words where the map comes from.

    Raises `MapFileError` if there is a file already, or if it cannot be made.
    """
    if path.exists():
        raise MapFileError(f"{path} exists already. Remove it or give another name.")
    with told(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(exist_ok=False)  # where no file can be made, SQLite does not say why
        with _removed_on_error(path):
            connection = _connection(path)
            with _closed_on_error(connection):
                connection.execute("BEGIN IMMEDIATE")
                _add_formats(connection, since=0)
                connection.execute(f"PRAGMA application_id = {APPLICATION}")
                origin = (source, digest, time.time())
                connection.execute("INSERT INTO origin VALUES (?, ?, ?)", origin)
                connection.execute("COMMIT")
    return connection


def connect(path: Path, *, read_only: bool = False) -> sqlite3.Connection:
    """Open a map file, whole and of the present format, in autocommit mode.

    A file of a former format is upgraded, and if only read, a copy of it in memory. Raises
    `MapFileError`, which names the file, what is wrong with it and the remedy.
    """
    _check_there(path)
    with told(path):
        connection = _connection(path, read_only)
        with _closed_on_error(connection):
            if _checked_format(path, connection) < _FORMAT:
                if read_only:
                    connection = _in_memory(connection)
                _upgrade(connection)
            _check_tables(path, connection)
            if not read_only:
                # WAL: a reader never stops the robot, and a commit is one append and one fsync.
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = FULL")
                connection.execute("BEGIN IMMEDIATE")
                connection.execute("ROLLBACK")
    return connection


def copy_map(original: Path, copy: Path) -> None:
    """Copy a map (which may stand in a read-only place) to `copy`, whole or not at all."""
    with closing(connect(original, read_only=True)) as source, told(copy):
        copy.parent.mkdir(parents=True, exist_ok=True)
        for stale in (copy, *companions(copy)):
            stale.unlink(missing_ok=True)
        with (
            replacing(copy) as part,
            closing(sqlite3.connect(part, isolation_level=None)) as target,
        ):
            source.backup(target)
            target.execute("UPDATE origin SET digest = ?", (_digest(source),))


def digest_of(path: Path) -> str:
    """What identifies the map in a file; what was taught to it beside the map makes no difference.

    Raises `MapFileError` if it cannot be read.
    """
    with closing(connect(path, read_only=True)) as connection, told(path):
        return _digest(connection)


@contextmanager
def peek(path: Path) -> Iterator[sqlite3.Connection]:
    """Read a little of a file that was checked before, of whatever format; errors as `connect`."""
    _check_there(path)
    with told(path), closing(_connection(path, read_only=True)) as connection:
        yield connection


def at_rest(path: Path) -> bool:
    """Whether no program has the file open for writing."""
    return not any(companion.exists() for companion in companions(path))


def companions(path: Path) -> list[Path]:
    """The files that SQLite keeps beside an open one."""
    return [path.with_name(path.name + suffix) for suffix in ("-wal", "-shm", "-journal")]


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Turn what SQLite and the file system raise into sentences that name file and remedy."""
    try:
        yield
    except sqlite3.Error as error:
        raise MapFileError(f"{path}: {error}. {_remedy(path, error)}.") from error
    except ValueError as error:  # of a row, or of bytes that are no text
        raise MapFileError(f"{path}: {error}. {_DAMAGED}.") from error
    except OSError as error:
        raise MapFileError(f"{error.filename or path}: {why(error)}.") from error


@contextmanager
def writing(path: Path, connection: sqlite3.Connection) -> Iterator[sqlite3.Connection]:
    """Write all that is executed, or nothing, when it is this writer's turn.

    Raises `MapFileError` if it cannot be written, or if another program has written for 5 s.
    """
    with told(path), connection:
        connection.execute("BEGIN IMMEDIATE")
        yield connection


def _check_there(path: Path) -> None:
    with told(path):
        if path.is_file():
            return
        if path.is_dir():
            raise MapFileError(f"{path} is a folder. Give a map file, such as one in it.")
        if path.exists():
            raise MapFileError(f"{path} is no file that can hold a map. Give another one.")
    raise MapFileError(
        f"{path}: no such map file. Make one with `cairn map import` or `cairn object teach`, "
        "or correct the path."
    )


def _connection(path: Path, read_only: bool = False) -> sqlite3.Connection:
    # A map at rest may stand where SQLite cannot make its lock files.
    mode = "mode=rwc" if not read_only else "immutable=1" if at_rest(path) else "mode=ro"
    # A component's calls come one at a time, but not always on the same thread.
    return sqlite3.connect(
        f"{path.resolve().as_uri()}?{mode}",
        uri=True,
        isolation_level=None,
        timeout=LOCK_WAIT_S,
        check_same_thread=False,
    )


@contextmanager
def _removed_on_error(path: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        path.unlink(missing_ok=True)
        raise


@contextmanager
def _closed_on_error(connection: sqlite3.Connection) -> Iterator[None]:
    try:
        yield
    except BaseException:
        connection.close()
        raise


def _checked_format(path: Path, connection: sqlite3.Connection) -> int:
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    if application != APPLICATION:
        raise MapFileError(
            f"{path} is not a visual map of Cairn. Give a file that `cairn map import` or `cairn "
            "object teach` wrote."
        )
    version = _format(connection)
    if not 1 <= version <= _FORMAT:
        raise MapFileError(
            f"{path} has format {version}, this Cairn reads formats up to {_FORMAT}. Import the "
            "map again, or run the Cairn that wrote it."
        )
    damage = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if damage != "ok":
        raise MapFileError(f"{path}: {' '.join(damage.split())}. {_DAMAGED}.")
    return version


def _check_tables(path: Path, connection: sqlite3.Connection) -> None:
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as model:
        _add_formats(model, since=0)
        if _columns(connection) != _columns(model):
            raise MapFileError(f"{path}: its tables are not those of a visual map. {_DAMAGED}.")


def _format(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _upgrade(connection: sqlite3.Connection) -> None:
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        _add_formats(connection, since=_format(connection))  # another may have done it meanwhile


def _add_formats(connection: sqlite3.Connection, since: int) -> None:
    for statements in FORMATS[since:]:
        for statement in statements:
            connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {_FORMAT}")


def _in_memory(file: sqlite3.Connection) -> sqlite3.Connection:
    memory = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    with closing(file):
        file.backup(memory)
    return memory


def _columns(connection: sqlite3.Connection) -> list[tuple[str, str, str]]:
    """Table, name and type of every column."""
    return connection.execute(
        "SELECT tables.name, columns.name, columns.type FROM sqlite_schema AS tables, "
        "pragma_table_info(tables.name) AS columns WHERE tables.type = 'table' "
        "ORDER BY tables.name, columns.cid"
    ).fetchall()


def _digest(connection: sqlite3.Connection) -> str:
    digest = hashlib.sha256()
    columns = _columns(connection)
    for table in ("origin", "objects", "changes"):
        # Without what was added for the file's sake: a copy that an older Cairn made is still one.
        names = ", ".join(name for of, name, _ in columns if of == table and name != "checksum")
        for row in connection.execute(f"SELECT {names} FROM {table} ORDER BY rowid"):
            digest.update(repr(row).encode())
    return digest.hexdigest()


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
            "It, or its folder, cannot be written: give it write permission, or use a copy (which "
            "the map builder makes by its parameter working_copy)"
        )
    if "locked" in text:
        return "Another program writes to it: stop that program"
    return _DAMAGED


def _is_full(folder: Path) -> bool:
    try:
        disk = shutil.disk_usage(folder)
        return disk.total > 0 and disk.free < _LITTLE_SPACE  # what is no disk has no size
    except OSError:
        return False
