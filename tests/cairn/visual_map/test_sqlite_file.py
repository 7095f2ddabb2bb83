"""Tests of the visual map's file: formats, upgrades, copies, digests."""

import hashlib
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from cairn.visual_map.object_models import add_views, read_models, read_revision
from cairn.visual_map.sqlite_file import (
    APPLICATION,
    FORMATS,
    MapFileError,
    connect,
    copy_map,
    create,
    digest_of,
)
from cairn.visual_map.sqlite_file import _upgrade as upgrade
from tests.cairn.visual_map.views import view
from tests.wording import words_in_order

ROOM = Path(__file__).parents[3] / "deploy" / "maps" / "room.cairn"


@pytest.fixture
def first_format(tmp_path: Path) -> Path:
    """Return a file of format 1."""
    path = tmp_path / "old.cairn"
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in FORMATS[0]:
            connection.execute(statement)
        connection.execute("INSERT INTO origin VALUES ('a test', '', 1.0)")
        connection.execute(
            "INSERT INTO objects (object_id, name, x, y, xx, xy, yy, reliability, state, "
            "evidence_count) VALUES (4, 'poster', 1, 2, 0.1, 0, 0.1, 0.5, 0, 0)"
        )
        connection.execute(f"PRAGMA application_id = {APPLICATION}")
        connection.execute("PRAGMA user_version = 1")
    return path


def test_reading_format_1_leaves_the_file_unchanged(first_format: Path) -> None:
    before = first_format.read_bytes()

    with closing(connect(first_format, read_only=True)) as connection:
        assert connection.execute("SELECT name FROM objects").fetchall() == [("poster",)]

    assert read_models(first_format).models == ()
    assert read_revision(first_format) == 0
    assert first_format.read_bytes() == before


def test_writing_upgrades_format_1(first_format: Path) -> None:
    same = digest_of(first_format)
    connect(first_format).close()

    with closing(sqlite3.connect(first_format)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone()[0] == len(FORMATS)
        assert connection.execute("SELECT name FROM objects").fetchall() == [("poster",)]
    assert add_views(first_format, "poster", [view(1)]) == 4
    assert digest_of(first_format) == same


def test_digest_of_format_2_matches_upgraded_copies(tmp_path: Path) -> None:
    old = tmp_path / "old.cairn"
    digest = hashlib.sha256()
    shutil.copy(ROOM, old)
    with closing(sqlite3.connect(old)) as connection, connection:
        connection.execute("ALTER TABLE objects DROP COLUMN checksum")
        connection.execute("ALTER TABLE taught_views DROP COLUMN checksum")
        connection.execute("PRAGMA user_version = 2")
        for table in ("origin", "objects", "changes"):  # the digest of format 2
            for row in connection.execute(f"SELECT * FROM {table} ORDER BY rowid"):
                digest.update(repr(row).encode())

    assert digest_of(old) == digest.hexdigest() == digest_of(ROOM)


def test_two_programs_can_upgrade_a_file_concurrently(
    first_format: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def after_another(connection: sqlite3.Connection) -> None:
        with monkeypatch.context() as only_once:
            only_once.setattr("cairn.visual_map.sqlite_file._upgrade", upgrade)
            add_views(first_format, "cup", [view(1)])
        upgrade(connection)

    monkeypatch.setattr("cairn.visual_map.sqlite_file._upgrade", after_another)
    connect(first_format).close()

    assert [known.name for known in read_models(first_format).models] == ["cup"]


def test_maps_in_deploy_can_be_read() -> None:
    with closing(connect(ROOM, read_only=True)) as connection:
        assert connection.execute("SELECT count(*) FROM objects").fetchone()[0] > 0


def test_copy_contains_object_models(tmp_path: Path) -> None:
    original, copy = tmp_path / "a.cairn", tmp_path / "b.cairn"
    create(original, "a test").close()
    add_views(original, "cup", [view(1)], (0.1, 0.2))

    copy_map(original, copy)

    (cup,) = read_models(copy).models
    assert (cup.name, cup.size, len(cup.views)) == ("cup", (0.1, 0.2), 1)


def test_object_models_do_not_change_the_digest(tmp_path: Path) -> None:
    path = tmp_path / "a.cairn"
    create(path, "a test").close()
    before = digest_of(path)

    add_views(path, "cup", [view(1)])
    assert digest_of(path) == before

    with closing(connect(path)) as connection:
        connection.execute("INSERT INTO changes VALUES (1, 0, 3, 'X', 0, 0, 0, 0, 1, 'a test')")
    assert digest_of(path) != before


def test_failed_creation_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as broken:
        broken.setattr("cairn.visual_map.sqlite_file.FORMATS", (("CREATE NONSENSE",),))
        with pytest.raises(MapFileError):
            create(tmp_path / "a.cairn", "a test")

    create(tmp_path / "a.cairn", "a test").close()


def test_file_with_other_tables_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a.cairn"
    with closing(create(path, "a test")) as connection:
        connection.execute("DROP TABLE taught_views")

    with pytest.raises(MapFileError, match=words_in_order("a.cairn", "not", "visual map")):
        connect(path, read_only=True)


def test_commits_are_written_to_disk_at_once(first_format: Path) -> None:
    with closing(connect(first_format)) as connection:
        synchronous = connection.execute("PRAGMA synchronous").fetchone()[0]

    assert synchronous == 2  # FULL: a commit survives a power failure
