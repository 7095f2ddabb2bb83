"""Read SQLite files with limits: no code in the schema, bounded values and a bounded effort.

The schema of a file may hold triggers, views and virtual tables, which run when a table is read or
written, and a damaged tree of pages may show more rows than could ever be read.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

from cairn.system.files import remove_side_files, replacing

_STEPS_AT_ONCE: Final = 20_000
_MOST_SCHEMA: Final = 100


class SchemaError(ValueError):
    """The schema of a file has something that its reader does not expect."""


def bound_connection(
    connection: sqlite3.Connection, *, longest: int, steps: int | None = None
) -> None:
    """Bound the values of a connection to `longest` bytes, and its effort to `steps` of SQLite.

    A row takes about 10 steps. What exceeds a bound raises `sqlite3.Error`.
    """
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, longest)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    if steps is None:
        return
    left = [steps]

    def count() -> bool:
        left[0] -= _STEPS_AT_ONCE
        return left[0] < 0

    connection.set_progress_handler(count, _STEPS_AT_ONCE)


def table_columns(
    connection: sqlite3.Connection, tables: Collection[str], indices: Collection[str]
) -> dict[str, dict[str, str]]:
    """Return the type of each column of each table.

    Raises `SchemaError` if there is anything but ordinary tables and indices of these names.
    """
    found: dict[str, dict[str, str]] = {}
    entries = connection.execute(
        "SELECT type, substr(name, 1, 100), upper(substr(coalesce(sql, ''), 1, 20)) "
        f"FROM sqlite_schema LIMIT {_MOST_SCHEMA + 1}"
    ).fetchall()
    if len(entries) > _MOST_SCHEMA:
        raise SchemaError(f"its schema has more than {_MOST_SCHEMA} entries")
    for kind, name, sql in entries:
        if str(name).startswith("sqlite_") and kind in ("table", "index"):
            continue
        if kind == "index" and name in indices:
            continue
        if kind != "table" or name not in tables or not str(sql).startswith("CREATE TABLE"):
            raise SchemaError(f"its schema has the {kind} {name!r}, which does not belong to it")
        columns = connection.execute(
            "SELECT name, type, hidden FROM pragma_table_xinfo(?)", (name,)
        ).fetchall()
        for column, _, hidden in columns:
            if hidden:
                raise SchemaError(f"the column {column[:100]!r} of its table {name} is computed")
        found[name] = {column: kind_of for column, kind_of, _ in columns}
    return found


@contextmanager
def replaced_by_copy(source: sqlite3.Connection, path: Path) -> Iterator[sqlite3.Connection]:
    """Yield a copy of a database, which becomes the file `path` if nothing fails.

    What was there before is removed first: its room on the disk may be needed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    remove_side_files(path)
    with replacing(path) as part, closing(sqlite3.connect(part, isolation_level=None)) as copy:
        source.backup(copy)
        # The log beside a file in WAL mode would not be renamed with it. Exclusively locked, the
        # file needs no shared memory to leave that mode.
        copy.execute("PRAGMA locking_mode = EXCLUSIVE")
        ((mode,),) = copy.execute("PRAGMA journal_mode = DELETE").fetchall()
        if mode != "delete":
            raise sqlite3.OperationalError(f"its journal mode is {mode}")
        yield copy
