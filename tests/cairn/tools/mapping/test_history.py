"""`cairn map history` and `cairn map rollback`."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.slam.graph_history import (
    GraphHistory,
    draw_state,
    read_log,
)
from cairn.components.slam.lifelong import LifelongMap
from cairn.planar.grid import OCCUPIED, UNKNOWN
from cairn.planar.map_file import read_map, write_map
from cairn.system.clock import SECOND
from cairn.visual_map.new_map import write_map as write_visual_map
from tests.commands import cairn
from tests.components.localizer.room import RESOLUTION
from tests.components.slam.changing_room import (
    MOVED,
    PERMANENT_S,
    TABLE,
    RepairedRoom,
    write_room_graph,
)
from tests.disk import room_for
from tests.sweeps import sampled
from tests.wording import assert_words

MORNING_S = 1_777_888_800.0  # 2026-05-04 10:00 UTC


@pytest.fixture
def changed(tmp_path: Path) -> Path:
    """The graph of a room in which a table was moved at 10 o'clock."""
    path = tmp_path / "room.graph"
    write_room_graph(path, [TABLE])
    with GraphHistory(path) as history:
        graph = LifelongMap(history, PERMANENT_S, 4.0)
        there = RepairedRoom([TABLE], draw_state(history.state(), RESOLUTION).grid())
        there.now_s = MORNING_S
        there.furnish([MOVED])
        there.drive(graph, PERMANENT_S)
        there.drive(graph, PERMANENT_S)
        assert graph.version > 0
        history.seal()
    return path


def test_history_lists_what_changed_when(changed: Path) -> None:
    shown = cairn("map", "history", str(changed))
    assert shown.code == 0
    assert_words(shown.out, "cells added", "2026-05-04 10:", "changed", "scans show it")

    rows = cairn("map", "history", str(changed), "--json").json
    assert rows["oldest"] == 0
    assert [row["version"] for row in rows["changes"]] == list(range(1, rows["version"] + 1))
    assert rows["changes"][0]["stamp_ns"] > MORNING_S * SECOND


def test_history_of_a_map_without_changes_is_empty(tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    write_room_graph(path, [TABLE])

    shown = cairn("map", "history", str(path))

    assert shown.code == 0
    assert "the map has no changes" in shown.out + shown.err


def test_history_of_a_visual_map_is_that_of_show(tmp_path: Path) -> None:
    file = tmp_path / "map.cairn"
    write_visual_map(file, "a test", [])

    rows = cairn("map", "history", str(file), "--json").json

    assert rows == {"version": 0, "changes": []}


def test_rollback_to_a_time_writes_the_map_of_then(changed: Path) -> None:
    answer = cairn("map", "rollback", str(changed), "2026-05-04 10:05")

    assert answer.code == 0, answer.err
    with GraphHistory(changed) as history:
        drawn = draw_state(history.state(0), RESOLUTION).grid()
    assert np.array_equal(read_map(changed.with_suffix(".yaml")).values, drawn.values)
    assert not changed.with_name("room.graph-wal").exists()
    rows = cairn("map", "history", str(changed), "--json").json["changes"]
    assert rows[-1]["kind"] == "rollback"
    assert rows[-1]["added"] > 0 < rows[-1]["removed"]

    back = cairn("map", "rollback", str(changed), str(rows[-2]["version"]), "--json")
    assert back.json["returned_to"] == rows[-2]["version"]


def test_rollback_keeps_what_was_drawn_by_hand(changed: Path) -> None:
    assert cairn("map", "rollback", str(changed), "0").code == 0
    file = changed.with_suffix(".yaml")
    before = read_map(file)
    row, column = before.frame.cell(-0.7, 1.0)
    stairs = np.s_[row : row + 6, column : column + 3]  # outside the room, where no scan came
    assert not (before.values[stairs] == OCCUPIED).any()
    before.values[stairs] = OCCUPIED
    write_map(file, before)

    answer = cairn("map", "rollback", str(changed), "1")

    after = read_map(file)
    row, column = after.frame.cell(*before.frame.point(row, column))
    assert (after.values[row : row + 6, column : column + 3] == OCCUPIED).all()
    assert "18 obstacle cells" in answer.out
    others = after.values.copy()
    others[row : row + 6, column : column + 3] = UNKNOWN
    with GraphHistory(changed) as history:
        drawn = draw_state(history.state(1), RESOLUTION).grid()
    assert np.count_nonzero(others == OCCUPIED) == np.count_nonzero(drawn.values == OCCUPIED)


@pytest.mark.parametrize("full_for", sampled(["grid map", "graph"]))
def test_rollback_on_a_full_disk_changes_neither_graph_nor_grid_map(
    changed: Path, monkeypatch: pytest.MonkeyPatch, full_for: str
) -> None:
    picture = changed.with_suffix(".pgm")
    picture.write_text("the grid map before")
    version = read_log(changed).version

    def full(*_arguments: object) -> int:
        raise CairnError("the graph takes no data; free disk space")

    if full_for == "graph":
        monkeypatch.setattr(GraphHistory, "rollback", full)
    with nullcontext() if full_for == "graph" else room_for(35_000):
        answer = cairn("map", "rollback", str(changed), "0")

    assert answer.code == 1
    assert "disk" in answer.err
    assert picture.read_text() == "the grid map before"
    assert read_log(changed).version == version
    assert not changed.with_suffix(".yaml").exists()
    assert list(changed.parent.glob(".*")) == []


def test_rollback_beyond_the_history_names_the_oldest_time(changed: Path) -> None:
    with GraphHistory(changed) as history:
        history.prune(keyframes=0, tiles=0, changes=100)
        oldest, newest = history.versions()
    assert oldest == newest

    answer = cairn("map", "rollback", str(changed), "2026-05-04 09:00")
    assert answer.code != 0
    assert_words(answer.err, "not kept", f"version {oldest}", "2026-05-04 10:")
    answer = cairn("map", "rollback", str(changed), "0")
    assert_words(answer.err, "version 0 is not kept", f"version {oldest}")
    assert not changed.with_suffix(".yaml").exists()


def test_rollback_refuses_what_is_no_time(changed: Path) -> None:
    answer = cairn("map", "rollback", str(changed), "yesterday")

    assert answer.code != 0
    assert_words(answer.err, "yesterday is not a time", "cairn map history")


def test_rollback_of_a_graph_in_use_is_refused(changed: Path) -> None:
    with GraphHistory(changed) as history:
        history.versions()
        answer = cairn("map", "rollback", str(changed), "0")

    assert answer.code != 0
    assert_words(answer.err, "locked", "close the other program")
