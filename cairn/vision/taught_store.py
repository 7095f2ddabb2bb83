"""Taught objects in the visual map's file: read, added to and removed."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from cairn.errors import CairnError
from cairn.vision.map_file import MapFileError, at_rest, connect, peek, told, writing
from cairn.vision.taught import TaughtObject, View
from cairn.vision.taught_rows import MOST_ID, size_from_row, view_from_row, view_row

Size = tuple[float, float]

_LONGEST_NAME = 100
_READINGS = 5


@dataclass(frozen=True)
class Taught:
    """What was taught to a map; `number` goes up with every change of it."""

    number: int
    objects: tuple[TaughtObject, ...]

    def named(self, name: str) -> TaughtObject | None:
        """The object of that name."""
        return next((known for known in self.objects if known.name == name), None)


def read_taught(path: Path, *, pictures: bool = True) -> Taught:
    """All objects that were taught to a map, by number.

    Without `pictures` those of the views are left out (0 x 0), which are large and which nothing
    is recognized by.

    Raises `MapFileError`, which names the file, what is wrong with it and the remedy.
    """
    for _ in range(_READINGS):
        before = _state(path)
        with closing(connect(path, read_only=True)) as connection, told(path):
            taught = _taught(path, connection, pictures)
        if before == _state(path):
            return taught
    raise MapFileError(f"{path} is written again and again while it is read. Try again later.")


def taught_number(path: Path) -> int:
    """What `read_taught` would give as `number`, but at once; raises `MapFileError` as it does."""
    with peek(path) as connection:
        before_format_2 = not connection.execute(
            "SELECT count(*) FROM sqlite_schema WHERE name = 'taught_changes'"
        ).fetchone()[0]
        return 0 if before_format_2 else _number(connection)


def taught_name(path: Path, object_id: int) -> str | None:
    """The name under which an object was taught, None if it was not; raises `MapFileError`."""
    with peek(path) as connection:
        row = connection.execute(
            "SELECT name FROM taught_objects WHERE object_id = ?", (object_id,)
        ).fetchone()
    return str(row[0]) if row else None


def teach(path: Path, name: str, views: Sequence[View], size: Size | None = None) -> int:
    """Add views to an object of that name, or a new object; return its number.

    A new object that the map holds under this name already keeps the map's number; else it gets
    one that no object had before. `size` (width, height [m]) is set if it is given. Raises
    `MapFileError` if the file cannot be written, `CairnError` if name or size cannot be, or if
    several objects of the map have the name.
    """
    check_name(name)
    if size is not None:
        try:
            size_from_row(*size)
        except ValueError as error:
            raise CairnError(f"{name}: {error}. Give width and height in meters.") from None
    with _changing(path) as connection:
        known = connection.execute(
            "SELECT object_id FROM taught_objects WHERE name = ?", (name,)
        ).fetchone()
        if known is None and not views:
            raise _unknown(path, name, connection)
        object_id = int(known[0]) if known else _new_id(path, name, connection)
        if known is None:
            connection.execute(
                "INSERT INTO taught_objects (object_id, name) VALUES (?, ?)", (object_id, name)
            )
        if size is not None:
            connection.execute(
                "UPDATE taught_objects SET width_m = ?, height_m = ? WHERE object_id = ?",
                (*size, object_id),
            )
        connection.executemany(
            "INSERT INTO taught_views (object_id, width, height, points, scales, angles, "
            "descriptors, picture, checksum) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (view_row(object_id, view) for view in views),
        )
    return object_id


def remove_taught(path: Path, name: str) -> int:
    """Forget what an object looks like and return its number; its place in the map is kept.

    Raises `MapFileError` if the file cannot be written, `CairnError` if no such object was taught.
    """
    with _changing(path) as connection:
        known = connection.execute(
            "SELECT object_id FROM taught_objects WHERE name = ?", (name,)
        ).fetchone()
        if known is None:
            raise _unknown(path, name, connection)
        for table in ("taught_views", "taught_objects"):
            connection.execute(f"DELETE FROM {table} WHERE object_id = ?", known)
    return int(known[0])


@contextmanager
def _changing(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(connect(path)) as connection, writing(path, connection):
        yield connection
        connection.execute("UPDATE taught_changes SET number = number + 1")


def _taught(path: Path, connection: sqlite3.Connection, pictures: bool) -> Taught:
    connection.execute("BEGIN")  # all of it as it was at one time
    objects = []
    picture = "picture" if pictures else "NULL"
    for object_id, name, width, height in connection.execute(
        "SELECT object_id, name, width_m, height_m FROM taught_objects ORDER BY object_id"
    ).fetchall():
        rows = connection.execute(
            f"SELECT object_id, width, height, points, scales, angles, descriptors, {picture}, "
            "checksum FROM taught_views WHERE object_id = ? ORDER BY view_id",
            (object_id,),
        )
        try:
            if not 0 <= object_id <= MOST_ID:
                raise ValueError(f"its number is not from 0 to {MOST_ID}")
            views = tuple(view_from_row(row, pictures) for row in rows)
            if not views:
                raise ValueError("it has no view")
            objects.append(TaughtObject(object_id, name, size_from_row(width, height), views))
        except (ValueError, TypeError) as error:
            raise MapFileError(
                f"{path}: the taught object {name!r} is damaged: {error}. Put back a copy of the "
                f"file, or remove the object (`cairn object remove`) and teach it again."
            ) from error
    return Taught(_number(connection), tuple(objects))


def _number(connection: sqlite3.Connection) -> int:
    row = connection.execute("SELECT number FROM taught_changes").fetchone()
    if row is None or not isinstance(row[0], int):
        raise ValueError("the count of changes of taught objects is missing")
    return int(row[0])


def _new_id(path: Path, name: str, connection: sqlite3.Connection) -> int:
    same = connection.execute(
        "SELECT object_id FROM objects WHERE name = ? ORDER BY object_id", (name,)
    ).fetchall()
    if len(same) > 1:
        numbers = ", ".join(str(row[0]) for row in same)
        raise CairnError(
            f"{path}: objects {numbers} of the map are all named {name!r}: it is not known which "
            "one is meant. Give another name."
        )
    if same:
        _check_free(path, name, int(same[0][0]), connection)
        return int(same[0][0])
    last = connection.execute(
        "SELECT max(coalesce((SELECT max(object_id) FROM objects), 0), "
        "coalesce((SELECT max(object_id) FROM changes), 0), "
        "coalesce((SELECT seq FROM sqlite_sequence WHERE name = 'taught_objects'), 0))"
    ).fetchone()
    return int(last[0]) + 1


def _check_free(path: Path, name: str, object_id: int, connection: sqlite3.Connection) -> None:
    taught = connection.execute(
        "SELECT name FROM taught_objects WHERE object_id = ?", (object_id,)
    ).fetchone()
    if taught is not None:
        raise CairnError(
            f"{path}: object {object_id}, which the map calls {name!r}, was taught as "
            f"{taught[0]!r}. Use that name, or give another one."
        )


def check_name(name: str) -> None:
    """Raise `CairnError` if no object can have this name."""
    if not name.strip() or name != name.strip() or not name.isprintable():
        raise CairnError(
            f"{name!r} cannot be an object's name: give one of visible characters, without spaces "
            "before or after"
        )
    if len(name) > _LONGEST_NAME:
        raise CairnError(
            f"{name[:20]!r}... has {len(name)} characters: give a name of at most {_LONGEST_NAME}"
        )


def _unknown(path: Path, name: str, connection: sqlite3.Connection) -> CairnError:
    rows = connection.execute("SELECT name FROM taught_objects ORDER BY name").fetchall()
    known = ", ".join(str(row[0]) for row in rows) or "none"
    return CairnError(f"{path}: no object {name!r} was taught; taught are: {known}.")


def _state(path: Path) -> tuple[int, int] | None:
    """What changes if a file at rest is written; None if it is not at rest.

    Of a file at rest no lock is taken when it is read, for it may stand in a read-only place.
    """
    with told(path):
        if not (path.is_file() and at_rest(path)):
            return None
        state = path.stat()
    return state.st_mtime_ns, state.st_size
