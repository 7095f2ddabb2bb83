"""Tests of the landmarks' file: commits survive kills, copies, damage, full disks."""

import json
import os
import signal
import sqlite3
import struct
import subprocess
import sys
import textwrap
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.map_builder.landmark_map import LandmarkKeeper
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.landmarks import ChangeKind, LandmarkChange, LandmarkState, MapPosition
from cairn.visual_map.new_map import write_map
from cairn.visual_map.object_models import add_views
from cairn.visual_map.sqlite_file import FORMATS, MapFileError, check_row, copy_map, row_checksum
from tests.cairn.visual_map.views import view
from tests.components.map_builder.evidence import THERE, observation, surveyed
from tests.patience import LIMIT_S
from tests.wording import assert_words


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "a.map"
    write_map(path, "a test", [surveyed(6), surveyed(7)])
    return path


def keep(path: Path, copy: Path | None = None, now_ns: int | None = 10**18) -> LandmarkKeeper:
    return LandmarkKeeper(path, copy, now_ns)


def test_changes_and_evidence_are_read_back(map_file: Path) -> None:
    keeper = keep(map_file)
    for step in range(6):
        keeper.apply(step, [observation(0.1 if step == 0 else 0.9, step, THERE)])
    keeper.save()
    keeper.close()

    with open_landmarks(map_file, read_only=True) as store:
        known = {o.object_id: o for o in store.landmarks()}
        assert known[7].state is LandmarkState.LIVE
        assert known[7].position is not None
        assert known[7].position.distance(THERE) < 0.1
        kinds = [row[3] for row in store.history()]
        assert kinds[:4] == [ChangeKind.IMPORTED.name] * 2 + [
            ChangeKind.REMOVED.name,
            ChangeKind.REGISTERED.name,
        ]
        evidence = store.evidence_of(7)
        assert [one.stamp_ns for one in evidence] == list(range(6))
        assert evidence[0].reliability == pytest.approx(0.1)


def test_imported_map_is_one_file_and_readable_in_a_read_only_folder(
    map_file: Path, tmp_path: Path
) -> None:
    assert [p.name for p in tmp_path.iterdir()] == [map_file.name]

    with open_landmarks(map_file, read_only=True) as store:
        assert len(store.landmarks()) == 2
    assert [p.name for p in tmp_path.iterdir()] == [map_file.name]


def test_working_copy_leaves_the_original_unchanged(map_file: Path) -> None:
    before = map_file.read_bytes()
    keeper = keep(map_file, map_file.with_name("copy.map"))
    keeper.apply(1, [observation(0.1, 0, THERE)])
    keeper.save()
    keeper.close()

    assert map_file.read_bytes() == before


@pytest.mark.parametrize("now_ns", [200, None])
def test_working_copy_is_reused_after_a_kill(map_file: Path, now_ns: int | None) -> None:
    copy = map_file.with_name("copy.map")
    first = keep(map_file, copy)
    first.apply(100, [observation(0.1, 0, THERE)])
    first.save()
    first.close()

    second = keep(map_file, copy, now_ns=now_ns)

    assert {o.object_id: o.state for o in second.landmarks}[7] is LandmarkState.RELOCATING
    second.close()


def truncate(copy: Path) -> None:
    copy.write_bytes(copy.read_bytes()[: copy.stat().st_size // 3])


def overwrite(copy: Path) -> None:
    with copy.open("r+b") as file:
        file.seek(2000)
        file.write(b"\xff" * 20_000)


def forge(copy: Path) -> None:
    with closing(sqlite3.connect(copy)) as connection, connection:
        connection.execute("UPDATE objects SET x = 3.5")


def replace_by_fifo(copy: Path) -> None:
    copy.unlink()
    os.mkfifo(copy)


@pytest.mark.parametrize("damage", [truncate, overwrite, forge, replace_by_fifo])
def test_damaged_copy_is_set_aside_and_replaced(
    map_file: Path, damage: Callable[[Path], None], caplog: pytest.LogCaptureFixture
) -> None:
    copy, kept = map_file.with_name("copy.map"), map_file.with_name("copy.damaged.map")
    before = keep(map_file, copy)
    landmarks = before.landmarks
    before.apply(100, [observation(0.1, 0, THERE)])
    before.save()
    before.close()
    damage(copy)

    after = keep(map_file, copy)

    assert after.landmarks == landmarks
    assert kept.exists()
    assert_words(caplog.text, f"{copy} cannot be used: ", f"it is kept as {kept}")
    after.close()
    keep(map_file, copy).close()


def test_object_taught_at_run_time_is_learned_with_its_name(
    map_file: Path,
) -> None:
    keeper = keep(map_file, map_file.with_name("copy.map"))
    object_id = add_views(map_file, "cup", [view(1)])

    for step in range(3):
        keeper.apply(step, [observation(0.5, step, THERE, object_id=object_id)])

    assert {o.object_id: o.name for o in keeper.landmarks}[object_id] == "cup"
    keeper.save()
    keeper.close()


def test_object_is_learned_without_its_name_if_the_map_is_missing(map_file: Path) -> None:
    keeper = keep(map_file, map_file.with_name("copy.map"))
    map_file.unlink()

    for step in range(3):
        keeper.apply(step, [observation(0.5, step, THERE, object_id=12)])

    assert {o.object_id: o.state for o in keeper.landmarks}[12] is LandmarkState.LIVE
    keeper.save()
    keeper.close()


def test_replay_from_the_start_replaces_the_working_copy(map_file: Path) -> None:
    copy = map_file.with_name("copy.map")
    first = keep(map_file, copy)
    first.apply(100, [observation(0.1, 0, THERE)])
    first.save()
    first.close()

    again = keep(map_file, copy, now_ns=50)

    assert {o.object_id: o.state for o in again.landmarks}[7] is LandmarkState.LIVE
    again.close()


def test_another_map_replaces_the_working_copy(map_file: Path) -> None:
    copy = map_file.with_name("copy.map")
    keep(map_file, copy).close()
    other = map_file.with_name("b.map")
    write_map(other, "another", [surveyed(9)])

    keeper = keep(other, copy)

    assert [o.object_id for o in keeper.landmarks] == [9]
    keeper.save()
    keeper.close()


WRITER = """
    import sys
    from pathlib import Path
    from tests.components.map_builder.evidence import HERE, THERE, observation
    from cairn.components.map_builder.landmark_map import LandmarkKeeper
    keeper = LandmarkKeeper(Path(sys.argv[1]), None, 0, True)
    step = 0
    while True:
        step += 1
        one = observation(0.1, step, THERE if step // 8 % 2 else HERE)
        changes = keeper.apply(step, [one])[1]
        if changes or step % 5 == 0:
            keeper.save()
        for version, change in changes:
            print(version, change.kind.name, flush=True)
"""


@pytest.mark.parametrize("seed", range(3))
def test_kill_while_writing_loses_no_reported_change(map_file: Path, seed: int) -> None:
    writer = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(WRITER), str(map_file)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    assert writer.stdout is not None
    printed = [writer.stdout.readline().split() for _ in range(3 + seed)]
    writer.send_signal(signal.SIGKILL)
    printed += [
        line.split() for line in writer.stdout.read().splitlines(keepends=True) if "\n" in line
    ]
    writer.wait(LIMIT_S)
    writer.stdout.close()

    with open_landmarks(map_file) as store:
        kept = {str(row[0]): row[3] for row in store.history()}
        assert len(store.landmarks()) == 2
    for version, kind in printed:
        assert kept[version] == kind
    assert sorted(map(int, kept)) == list(range(1, len(kept) + 1))


def broken(path: Path, how: str) -> None:
    data = path.read_bytes()
    if how == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif how == "text":
        path.write_text("not a map\n" * 200)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "foreign":
        path.unlink()
        with sqlite3.connect(path) as other:
            other.execute("CREATE TABLE t (a)")
        other.close()
    elif how == "newer":
        with sqlite3.connect(path) as other:
            other.execute("PRAGMA user_version = 99")
        other.close()
    else:
        path.unlink()


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("truncated", "damaged"),
        ("text", "damaged or not a map"),
        ("empty", "not a visual map of Cairn"),
        ("foreign", "not a visual map of Cairn"),
        ("newer", f"has format 99, this Cairn reads formats up to {len(FORMATS)}"),
        ("missing", "no such map file"),
    ],
)
@pytest.mark.parametrize("read_only", [True, False])
def test_invalid_file_is_rejected_by_name(
    map_file: Path, how: str, message: str, read_only: bool
) -> None:
    broken(map_file, how)

    with pytest.raises(MapFileError) as raised:
        open_landmarks(map_file, read_only=read_only)

    assert str(map_file) in str(raised.value)
    assert message in str(raised.value)


def test_locked_map_is_reported(map_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cairn.visual_map.sqlite_file.LOCK_WAIT_S", 0.05)
    other = sqlite3.connect(map_file, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")

    with pytest.raises(MapFileError, match="Another program is writing to it"):
        open_landmarks(map_file)
    other.close()


def test_full_disk_is_reported_with_the_file(map_file: Path) -> None:
    keeper = keep(map_file)
    assert keeper.store is not None
    keeper.store._connection.execute("PRAGMA max_page_count = 1")

    for step in range(400):
        keeper.apply(step, [observation(0.9, step)])
    with pytest.raises(MapFileError, match=r"a.map: database or disk is full.*free some space"):
        keeper.save()
    keeper.close()


def test_uncreatable_folder_of_the_working_copy_is_reported(map_file: Path) -> None:
    with pytest.raises(MapFileError, match=r"a\.map.*(Not a directory|File exists)"):
        copy_map(map_file, map_file / "copy.map")


def test_history_is_printed_as_json(map_file: Path) -> None:
    keeper = keep(map_file)
    keeper.apply(5, [observation(0.1, 0, THERE)])
    keeper.save()
    keeper.close()

    with open_landmarks(map_file, read_only=True) as store:
        last = json.loads(json.dumps(store.history()))[-1]
    assert last[2:5] == [7, "REMOVED", pytest.approx(0.1)]
    assert "1.50 m away" in last[5]


def test_damaged_position_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "b.map"
    write_map(
        path, "a test", [replace(surveyed(), position=MapPosition(0.3, 0.7, 0.01, 0.0, 0.01))]
    )
    data = bytearray(path.read_bytes())
    data[data.index(struct.pack(">d", 0.3)) + 3] ^= 0x08  # as SQLite writes it
    path.write_bytes(data)

    with pytest.raises(MapFileError, match=r"object 7: .*checksum differs") as printed:
        open_landmarks(path, read_only=True).landmarks()

    assert "b.map" in str(printed.value)
    assert "restore a copy" in str(printed.value)


VALUES = st.one_of(
    st.none(),
    st.text(st.characters(codec="utf-8", exclude_characters="\0")),
    st.binary(),
    st.floats(-1e9, 1e9),
    st.integers(0, 2**32),
)


@given(st.lists(VALUES))
def test_checksum_of_a_row_survives_the_file(values: list[Any]) -> None:
    with closing(sqlite3.connect(":memory:")) as connection:
        kinds = {float: "REAL", int: "REAL", bytes: "BLOB"}
        columns = [f"c{k} {kinds.get(type(value), 'TEXT')}" for k, value in enumerate(values)]
        connection.execute(f"CREATE TABLE t ({', '.join(['c INTEGER', *columns])})")
        marks = ", ".join("?" * (len(values) + 1))
        connection.execute(f"INSERT INTO t VALUES ({marks})", (row_checksum(values), *values))
        stored, *row = connection.execute("SELECT * FROM t").fetchone()

    check_row(row, stored)


def test_evidence_beyond_the_bound_of_memory_becomes_a_summary(
    map_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.components.map_builder.landmark_map.MOST_UNSAVED_EVIDENCE", 10)
    keeper = keep(map_file)
    for step in range(25):
        keeper.apply(step, [observation(0.9, step)])
    assert "10 pieces of evidence are lost (15 older" in keeper.unsaved
    keeper.save()

    with open_landmarks(map_file, read_only=True) as store:
        assert [one.stamp_ns for one in store.evidence_of(7)] == list(range(15, 25))
        summary = store.evidence_summaries_of(7)
        assert [(one.pieces, one.first_ns, one.last_ns) for one in summary] == [(15, 0, 14)]
        assert {o.object_id: o.evidence_count for o in store.landmarks()}[7] == 25
    keeper.close()


def test_stored_evidence_is_bounded_and_summaries_count_the_rest(
    map_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, most in (("MOST_COUNTED", 20), ("MOST_UNCOUNTED", 10), ("MOST_ROWS", 40)):
        monkeypatch.setattr(f"cairn.visual_map.evidence_history.{name}", most)
    keeper = keep(map_file)
    applied = 0
    for step in range(300):
        pieces = [observation(0.9, step, object_id=one) for one in (6, 7)]
        if step % 3 == 0:
            pieces.append(observation(0.9, step))  # from the same pose: it does not count
        keeper.apply(step, pieces)
        keeper.save()
        applied += len(pieces)
    keeper.close()

    with open_landmarks(map_file, read_only=True) as store:
        rows = {one: store.evidence_of(one) for one in (6, 7)}
        summaries = [one for of in (6, 7) for one in store.evidence_summaries_of(of)]
    assert 40 <= sum(map(len, rows.values())) <= 48
    assert sum(map(len, rows.values())) + sum(one.pieces for one in summaries) == applied
    assert rows[7][-1].stamp_ns == 299
    assert {(one.object_id, one.counted) for one in summaries} == {(6, True), (7, True), (7, False)}


def test_only_the_newest_changes_are_kept(map_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cairn.visual_map.landmark_store.MOST_CHANGES", 5)
    change = LandmarkChange(7, ChangeKind.REFINED, None, THERE, 0.5, "an observation")
    with open_landmarks(map_file) as store:
        first = store.version() + 1
        for version in range(first, first + 20):
            store.commit([], changes=[(version, version, change)])

        assert [row[0] for row in store.history()] == list(range(first + 15, first + 20))


def test_working_copy_has_room_for_its_evidence(map_file: Path) -> None:
    copy = map_file.with_name("copy.map")
    keeper = keep(map_file, copy)
    size = copy.stat().st_size
    here = surveyed(7).position
    assert here is not None
    for step in range(1500):
        keeper.apply(step, [observation(0.9, step % 50, here)])
        if step % 500 == 0:
            keeper.save()
    keeper.save()
    keeper.close()

    assert copy.stat().st_size == size
