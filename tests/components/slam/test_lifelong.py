"""Permanent changes of a room go into its graph, which stays small."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from cairn.components.slam.graph_file import read_graph
from cairn.components.slam.graph_history import (
    ChangedBlock,
    GraphHistory,
    draw_state,
    read_log,
)
from cairn.components.slam.lifelong import LifelongMap, bridging
from cairn.components.slam.map_differences import differing
from cairn.components.slam.pose_graph import Edge, EdgeKind
from cairn.errors import CairnError
from cairn.planar.grid import FREE, OCCUPIED, Grid, OccupancyCells
from cairn.planar.poses import relative
from tests.components.localizer.room import RESOLUTION, Box
from tests.components.slam.changing_room import (
    MOVED,
    PERMANENT_S,
    ROUND,
    TABLE,
    RepairedRoom,
    random_boxes,
    write_room_graph,
)
from tests.disk import room_for


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "room.graph"
    write_room_graph(path, [TABLE])
    return path


@pytest.fixture
def history(file: Path) -> Iterator[GraphHistory]:
    with GraphHistory(file) as history:
        yield history


def lifelong(history: GraphHistory, per_m2: float = 4.0) -> LifelongMap:
    return LifelongMap(history, PERMANENT_S, per_m2)


def furnished(history: GraphHistory) -> RepairedRoom:
    return RepairedRoom([TABLE], draw_state(history.state(), RESOLUTION).grid())


def size_of(file: Path) -> int:
    """Size of a database [bytes], with what its log has."""
    with closing(sqlite3.connect(file)) as connection:
        ((pages,),) = connection.execute("PRAGMA page_count").fetchall()
        ((size,),) = connection.execute("PRAGMA page_size").fetchall()
    return int(pages * size)


def drawn_by(graph: LifelongMap) -> OccupancyCells:
    assert graph.drawing is not None
    return graph.drawing.grid()


def differences(graph: LifelongMap, there: RepairedRoom) -> int:
    """Number of cells in which the drawing differs from the repaired grid map."""
    drawn = drawn_by(graph)
    (x, y), (row, column) = drawn.frame.origin[:2], there.grid.values.shape
    cells = np.full((row, column), -1, np.int8)
    top = round((y - there.grid.frame.origin[1]) / RESOLUTION)
    left = round((x - there.grid.frame.origin[0]) / RESOLUTION)
    for r, values in enumerate(drawn.values):
        for c, value in enumerate(values):
            if 0 <= r + top < row and 0 <= c + left < column:
                cells[r + top, c + left] = value
    return int(np.count_nonzero(differing(there.grid.values, cells)))


def at(grid: Grid[np.int8], x: float, y: float) -> int:
    row, column = grid.frame.cell(x, y)
    return int(grid.values[row, column])


def obstacles_in(grid: Grid[np.int8], box: Box) -> int:
    """Number of obstacle cells in a box, with 5 cm around it."""
    top, left = grid.frame.cell(box[0] - 0.05, box[1] - 0.05)
    bottom, right = grid.frame.cell(box[2] + 0.05, box[3] + 0.05)
    return int(np.count_nonzero(grid.values[top : bottom + 1, left : right + 1] == OCCUPIED))


def test_unchanged_room_leaves_the_graph_as_it_is(history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)

    for _ in range(3):
        assert there.drive(graph, PERMANENT_S + 60.0) == []

    assert graph.version == 0
    assert graph.keyframes == len(ROUND)


def test_table_that_was_moved_for_good_is_moved_in_the_graph(history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)

    there.furnish([MOVED])
    made = there.drive(graph, PERMANENT_S) + there.drive(graph, PERMANENT_S)

    assert made
    drawn = drawn_by(graph)
    assert at(drawn, 4.75, 3.3) == FREE  # the middle of the old place
    assert obstacles_in(drawn, MOVED) > 30
    assert differences(graph, there) == 0
    assert np.array_equal(draw_state(history.state(), RESOLUTION).grid().values, drawn.values), (
        "the file has another map"
    )


def test_short_change_does_not_reach_the_graph(history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)

    there.furnish([MOVED])
    assert there.drive(graph, PERMANENT_S - 100.0) == []
    there.furnish([TABLE])
    assert there.drive(graph, PERMANENT_S) == []

    assert graph.version == graph.pending == 0


def test_restart_does_not_delay_a_change(file: Path) -> None:
    with GraphHistory(file) as history:
        graph, there = lifelong(history), furnished(history)
        there.furnish([MOVED])
        there.drive(graph, PERMANENT_S - 100.0)
        pending = graph.pending
        assert pending > 0
    with GraphHistory(file) as history:
        graph = lifelong(history)
        assert graph.pending == pending
        assert there.drive(graph, 100.0)
        there.drive(graph, PERMANENT_S)  # the rest of it
        assert differences(graph, there) == 0
        there.drive(graph, 60.0)
        assert history.differences() == {}


def test_difference_that_ended_while_the_keeper_did_not_run_is_forgotten(file: Path) -> None:
    with GraphHistory(file) as history:
        graph, there = lifelong(history), furnished(history)
        there.furnish([MOVED])
        there.drive(graph, PERMANENT_S - 100.0)
    there.furnish([TABLE])
    with GraphHistory(file) as history:
        assert history.differences() != {}
        graph = lifelong(history)
        assert there.drive(graph, PERMANENT_S) == []
        assert history.differences() == {}


def test_time_that_was_set_back_starts_the_wait_again(file: Path) -> None:
    with GraphHistory(file) as history:
        graph, there = lifelong(history), furnished(history)
        there.furnish([MOVED])
        there.drive(graph, PERMANENT_S - 100.0)
    there.now_s -= 2.0 * PERMANENT_S
    with GraphHistory(file) as history:
        graph = lifelong(history)
        assert there.drive(graph, PERMANENT_S - 100.0) == []
        assert there.drive(graph, PERMANENT_S)


def test_damaged_note_of_a_difference_is_reported(file: Path) -> None:
    with GraphHistory(file) as history:
        history.note_differences({(1, 2): ChangedBlock(5, frozenset({(3, 4)}))}, ())
        assert history.differences() == {(1, 2): ChangedBlock(5, frozenset({(3, 4)}))}
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE differences SET cells = x'0102030405'")
    with GraphHistory(file) as history, pytest.raises(CairnError, match="damaged graph"):
        lifelong(history)


def test_obstacle_that_no_scan_shows_is_not_taken_from_the_grid_map(history: GraphHistory) -> None:
    """Such as glass that was drawn by hand."""
    graph, there = lifelong(history), furnished(history)
    cells = there.grid.values.copy()
    row, column = there.grid.frame.cell(6.5, 2.5)
    cells[row, column : column + 20] = OCCUPIED
    there.grid = Grid(cells, there.grid.frame)

    made = [change for _ in range(3) for change in there.drive(graph, PERMANENT_S + 60.0)]

    assert made == []
    assert graph.pending > 0


def test_person_in_a_scan_is_not_drawn(history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)
    there.furnish([MOVED])
    repaired, person = there.grid, (4.9, 3.1, 5.2, 3.4)  # where the table was
    there.furnish([MOVED, person])
    there.grid = repaired  # the map builder leaves out what does not stay

    there.drive(graph, PERMANENT_S)
    there.drive(graph, 60.0)

    assert graph.version > 0
    assert obstacles_in(drawn_by(graph), person) == 0


def test_other_building_is_not_mapped_into_the_graph(history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)
    there.grid = Grid(np.roll(there.grid.values, (30, 40), (0, 1)), there.grid.frame)

    assert there.drive(graph, PERMANENT_S + 60.0) == []

    assert graph.is_of_other_building


def test_turned_grid_map_is_refused(history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)
    x, y, _ = there.grid.frame.origin
    frame = type(there.grid.frame)(RESOLUTION, (x, y, 0.3))
    graph.set_map(Grid(there.grid.values, frame))

    with pytest.raises(CairnError, match=r"turned by 0\.300 rad"):
        graph.work(0)


def test_map_is_extended_without_what_is_gone(file: Path, history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)
    there.furnish([MOVED])
    there.drive(graph, PERMANENT_S)
    there.drive(graph, 60.0)

    mapper = read_graph(file)

    assert mapper.version == graph.version
    assert mapper.in_map().all(), "retired keyframes have left islands"
    points = np.concatenate(
        [
            frame.cloud.placed((x, y, theta)).points
            for frame, (x, y, theta) in zip(
                mapper.keyframes, mapper.graph.poses.tolist(), strict=True
            )
        ]
    )
    left, bottom, right, top = TABLE
    inside = (points > (left + 0.6, bottom - 0.05)) & (points < (right + 0.05, top + 0.05))
    assert not inside.all(axis=1).any(), "points of the old table are left"
    assert [submap.last - submap.first >= 0 for submap in mapper.submaps]
    assert mapper.submaps[-1].last == len(mapper.keyframes) - 1


def test_full_disk_delays_a_change(file: Path, history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)
    there.furnish([MOVED])

    there.drive(graph, PERMANENT_S, [])
    with room_for(5_000), pytest.raises(CairnError, match="disk"):
        there.drive(graph, 60.0)
    assert graph.version == read_log(file).version == 0

    there.drive(graph, 60.0)
    there.drive(graph, PERMANENT_S)
    assert graph.version == read_log(file).version > 0
    assert differences(graph, there) == 0


def test_change_by_another_program_is_not_overwritten(file: Path, history: GraphHistory) -> None:
    graph, there = lifelong(history), furnished(history)
    there.furnish([MOVED])
    there.drive(graph, PERMANENT_S)
    there.drive(graph, 60.0)
    assert graph.version > 0
    with GraphHistory(file) as other:
        other.rollback(0, 1, "a test")
    there.furnish([])
    there.drive(graph, PERMANENT_S, [])

    with pytest.raises(CairnError, match="another program"):
        there.drive(graph, 60.0)


def test_sizes_do_not_grow_with_the_number_of_changes(file: Path) -> None:
    random = np.random.default_rng(4)
    boxes: list[Box] = [TABLE]
    kept = []
    with GraphHistory(file) as history:
        graph, there = lifelong(history, per_m2=0.5), furnished(history)
        for _ in range(24):
            boxes = random_boxes(boxes, random)
            there.furnish(boxes)
            there.drive(graph, 2 * PERMANENT_S)
            kept.append((graph.keyframes, size_of(file)))
        for _ in range(3):
            there.drive(graph, 2 * PERMANENT_S)

        assert differences(graph, there) <= 6
        assert history.versions()[0] > 0, "all history is kept"
        log = read_log(file)
        assert log.version > 20
    area = 9.0 * 7.0
    assert max(keyframes for keyframes, _ in kept) <= 0.5 * area + 8 + 1
    early, late = kept[:16], kept[16:]
    assert max(size for _, size in late) <= 1.2 * max(size for _, size in early)


def test_bridges_connect_what_retired_keyframes_had_connected() -> None:
    poses = {k: (float(k), 0.1 * k, 0.2 * k) for k in range(6)}
    steps = [
        Edge(EdgeKind.STEP, k, k + 1, relative(poses[k], poses[k + 1]), np.eye(3) * (100 + k))
        for k in range(5)
    ]

    added = bridging(steps, {1, 2, 4}, poses)

    assert sorted((min(e.first, e.second), max(e.first, e.second)) for e in added) == [
        (0, 3),
        (3, 5),
    ]
    for edge in added:
        assert edge.measured == pytest.approx(relative(poses[edge.first], poses[edge.second]))
        assert 0.0 < edge.information[0, 0] < 60.0, "a bridge is less certain than its parts"
