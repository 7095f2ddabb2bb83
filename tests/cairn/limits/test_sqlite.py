"""Copies of databases: complete or not there, however little room the disk has."""

import sqlite3
from contextlib import closing
from pathlib import Path

from cairn.limits.sqlite import replaced_by_copy
from tests.disk import small_disk

ROWS = [(number, bytes(3000)) for number in range(30)]
MORE = [(number + 30, data) for number, data in ROWS]


def database(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("CREATE TABLE rows (number INTEGER PRIMARY KEY, data BLOB)")
    connection.executemany("INSERT INTO rows VALUES (?, ?)", ROWS)
    return connection


def read(path: Path) -> list[tuple[int, bytes]]:
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        return connection.execute("SELECT * FROM rows ORDER BY number").fetchall()


def test_copy_is_complete_or_not_there_however_full_the_disk_is(tmp_path: Path) -> None:
    outcomes = []
    with (
        closing(database(tmp_path / "a.db")) as source,
        small_disk(tmp_path / "disk", 1 << 20) as disk,
    ):
        copy, ballast = disk / "copy.db", disk / "ballast"
        for room in range(8 << 10, 480 << 10, 8 << 10):
            ballast.write_bytes(bytes((1 << 20) - room))
            try:
                with replaced_by_copy(source, copy) as target:
                    target.execute("INSERT INTO rows SELECT number + 30, data FROM rows")
            except sqlite3.Error:
                outcomes.append(False)
                assert [file.name for file in disk.iterdir()] == ["ballast"], room
            else:
                outcomes.append(True)
                assert read(copy) == ROWS + MORE, room
            copy.unlink(missing_ok=True)
            ballast.unlink()
    assert outcomes == sorted(outcomes)
    assert set(outcomes) == {False, True}


def test_journal_that_a_killed_process_left_is_not_applied_to_the_copy(tmp_path: Path) -> None:
    copy = tmp_path / "copy.db"
    for name in ("copy.db-wal", "copy.db.part-journal", "copy.db.part-wal", "copy.db.part"):
        (tmp_path / name).write_bytes(bytes(5000))
    with closing(database(tmp_path / "a.db")) as source:
        with replaced_by_copy(source, copy):
            pass
        assert read(copy) == ROWS
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.db", "copy.db"]
