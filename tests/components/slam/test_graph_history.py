"""The history of a graph file: changes, rollbacks, and what is kept of them."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.slam.graph_file import GraphFile, read_graph, write_graph
from cairn.components.slam.graph_history import (
    ChangedBlock,
    GraphChange,
    GraphHistory,
    Renewal,
    copy_graph,
    draw_state,
    graph_digest,
    read_log,
)
from cairn.components.slam.keyframes import Keyframe, scan_cloud, scan_rays, scan_surfaces
from cairn.components.slam.lifelong import bridging
from cairn.components.slam.map_grid import MapGrid
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.pose_graph import Edge, EdgeKind
from cairn.errors import CairnError
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose, relative
from cairn.planar.scans import Rays
from cairn.system.clock import SECOND
from tests.components.localizer.room import room
from tests.components.slam.box_room import drive, scan
from tests.components.slam.changing_room import REACH, ROUND, TABLE, scan_at, write_room_graph
from tests.components.slam.map_errors import islands_of
from tests.wording import words_in_order

FEW = ROUND[::4]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("graph") / "room.graph"
    write_room_graph(path, [TABLE], FEW)
    return path


def change_at(stamp_s: float) -> GraphChange:
    return GraphChange(round(stamp_s * SECOND), "changed", 1.0, 2.0, 0.5, 0.5, 3, 4, "a test")


def renew(history: GraphHistory, seed: int, retired: Sequence[int] = ()) -> int:
    """Renew a random part of the room by a scan."""
    random = np.random.default_rng(seed)
    state = history.state()
    pose: Pose = ROUND[seed % len(ROUND)]
    rays = scan_at(room(()), pose, random)
    patches = random.integers(20, 60, (30, 2))
    frame = Keyframe(
        seed, pose, scan_surfaces(scan_cloud(rays, REACH)), scan_rays(rays), 0, state.version + 1
    )
    number = history.next_number()
    edges = []
    if state.numbers:
        anchor = state.numbers[-1]
        x, y, theta = state.poses[-1].tolist()
        edges = [Edge(EdgeKind.MATCH, anchor, number, relative((x, y, theta), pose), np.eye(3))]
        poses = {k: (x, y, t) for k, (x, y, t) in zip(state.numbers, state.poses, strict=True)}
        known = [*history.edges(state.numbers), *edges]
        edges += bridging(known, retired, {**poses, number: pose})
    renewals = state.renewals.renewed(np.unique(patches, axis=0), state.version + 1)
    change = change_at(100.0 * (state.version + 1))
    renewal = Renewal(change, [pose], [frame], renewals, retired, edges)
    return history.renew(state.version, renewal)


def drawing(history: GraphHistory, version: int | None = None) -> OccupancyCells:
    return draw_state(history.state(version), 0.1).grid()


def same(first: OccupancyCells, second: OccupancyCells) -> bool:
    return first.frame == second.frame and np.array_equal(first.values, second.values)


def test_keyframes_of_an_unfinished_submap_stay_a_submap_of_their_own(tmp_path: Path) -> None:
    """Otherwise a robot that extends the map would not search for what they have seen."""
    path = tmp_path / "room.graph"
    mapper = Mapper(10.0)
    drive(mapper, 0, 60)
    open_from = mapper.submaps[-1].last + 1
    assert open_from < len(mapper.keyframes)
    write_graph(path, mapper, "a robot that maps")

    with GraphHistory(path) as history:
        renew(history, 1)

    ends = [(submap.first, submap.last) for submap in read_graph(path).submaps]
    count = len(mapper.keyframes)
    assert ends[-2:] == [(open_from, count - 1), (count, count)]


def test_parts_that_nothing_joins_to_the_map_are_not_drawn(tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    mapper = Mapper(10.0)
    drive(mapper, 0, 40)
    for k in range(20):  # the robot was carried into a smaller room
        seen = scan((0.1 * k / 0.6, 0.0, 0.0))
        rays = Rays(seen.starts, seen.angles, 0.6 * seen.ranges, seen.reach)
        mapper.add_scan((40 + k) * SECOND, (3.9 + 0.1 * k, 0.0, 0.0), rays)
    mapper.finish()
    assert len(islands_of(mapper)) == 2
    write_graph(path, mapper, "a test")
    grid = MapGrid(0.1, 10.0)
    grid.update(mapper.keyframes, mapper.graph.poses, mapper.in_map())

    with GraphHistory(path) as history:
        assert same(drawing(history), grid.counts.grid())


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("renew"), st.integers(0, 1000)),
        st.tuples(st.just("rollback"), st.integers(0, 1000)),
        st.tuples(st.just("prune"), st.integers(0, 3)),
        st.tuples(st.just("reopen"), st.just(0)),
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=15, deadline=None)
@given(steps=STEPS)
def test_each_kept_version_is_drawn_as_it_was(
    original: Path, tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[str, int]]
) -> None:
    path = tmp_path_factory.mktemp("steps") / "room.graph"
    copy_graph(original, path)
    history = GraphHistory(path)
    drawn = {0: drawing(history)}

    for what, value in steps:
        oldest, newest = history.versions()
        state = history.state()
        if what == "renew":
            retired = [k for k in state.numbers[:-1] if (k + value) % 5 == 0]
            version = renew(history, value, retired)
            drawn[version] = drawing(history)
        elif what == "rollback" and newest > oldest:
            target = oldest + value % (newest - oldest)
            version = history.rollback(target, 1, "a test")
            assert same(drawing(history), drawn[target])
            drawn[version] = drawn[target]
        elif what == "prune":
            history.prune(keyframes=value, tiles=2 * value, changes=value)
        elif what == "reopen":
            history.close()
            history = GraphHistory(path)

    oldest, newest = history.versions()
    for version in range(oldest, newest + 1):
        assert same(drawing(history, version), drawn[version]), (version, steps)
    history.close()
    assert len(read_graph(path).keyframes) == len(set(history_numbers(path)))


def history_numbers(path: Path) -> list[int]:
    with GraphHistory(path) as history:
        return history.state().numbers


def test_budget_bounds_what_is_kept(original: Path, tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    copy_graph(original, path)
    with GraphHistory(path) as history:
        for seed in range(30):
            renew(history, seed, history.state().numbers[:1])
            history.prune(keyframes=5, tiles=12, changes=7)
        oldest, newest = history.versions()
    assert newest == 30
    assert 20 <= oldest < 30
    with closing(sqlite3.connect(path)) as connection:
        for table, most in (("keyframes", len(FEW) + 5), ("poses", len(FEW) + 5), ("changes", 30)):
            ((count,),) = connection.execute(f"SELECT count(*) FROM {table}").fetchall()
            assert count <= most, table
        ((former,),) = connection.execute(
            "SELECT count(*) FROM places WHERE until IS NOT NULL"
        ).fetchall()
        assert former <= 12
    log = read_log(path)
    assert log.changes[0][0] <= max(oldest, 23)
    assert log.version_at(0) is None
    assert log.version_at(round(100.0 * oldest * SECOND)) == oldest
    assert log.version_at(10**18) == 30


def test_rollback_to_a_deleted_version_names_what_is_kept(original: Path, tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    copy_graph(original, path)
    with GraphHistory(path) as history:
        for seed in range(4):
            renew(history, seed, history.state().numbers[:1])
        history.prune(keyframes=1, tiles=100, changes=100)
        oldest, _ = history.versions()
        assert oldest > 0
        with pytest.raises(CairnError, match=f"keeps the versions {oldest} to 4 of the map; 0 is"):
            history.rollback(0, 1, "a test")


def test_rollback_is_undone_by_another_one(original: Path, tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    copy_graph(original, path)
    with GraphHistory(path) as history:
        renew(history, 3, [0])
        after = drawing(history)
        history.rollback(0, 5, "a test")
        assert not same(drawing(history), after)
        history.rollback(1, 6, "a test")
        assert same(drawing(history), after)
    kinds = [change.kind for _, change in read_log(path).changes]
    assert kinds == ["changed", "rollback", "rollback"]


def test_change_of_another_version_is_refused(original: Path, tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    copy_graph(original, path)
    with GraphHistory(path) as history:
        renew(history, 3)
        state = history.state()
        renewal = Renewal(change_at(1.0), [], [], state.renewals, [], [])
        with pytest.raises(CairnError, match="another program has changed the map to version 1"):
            history.renew(0, renewal)
    assert read_log(path).version == 1


def test_copy_knows_its_original_and_leaves_it_unchanged(original: Path, tmp_path: Path) -> None:
    before = original.read_bytes()
    path = tmp_path / "folder" / "copy.graph"
    copy_graph(original, path)
    with GraphHistory(path) as history:
        renew(history, 3)

    assert read_log(path).origin == graph_digest(original)
    assert original.read_bytes() == before


def test_copy_has_no_differences_of_the_original_s_grid_map(original: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first.graph", tmp_path / "second.graph"
    copy_graph(original, first)
    with GraphHistory(first) as history:
        history.note_differences({(1, 2): ChangedBlock(5, frozenset({(3, 4)}))}, ())
    copy_graph(first, second)
    with GraphHistory(second) as history:
        assert history.differences() == {}


def test_extended_map_keeps_renewed_places_and_starts_a_history(
    original: Path, tmp_path: Path
) -> None:
    path, extended = tmp_path / "room.graph", tmp_path / "extended.graph"
    copy_graph(original, path)
    with GraphHistory(path) as history:
        renew(history, 3, [1])
        wanted = drawing(history)
    with pytest.raises(CairnError, match="has a history of changes"):
        GraphFile.open(path)

    write_graph(extended, read_graph(path), "a test")

    log = read_log(extended)
    assert (log.oldest, log.version, log.changes) == (1, 1, [])
    with GraphHistory(extended) as history:
        assert same(drawing(history), wanted)
    file, mapper = GraphFile.open(extended)
    file.close()
    assert mapper.version == 1


def test_free_pages_return_to_the_disk(original: Path, tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    copy_graph(original, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE filler (data BLOB)")
        connection.executemany("INSERT INTO filler VALUES (zeroblob(4000))", [()] * 2000)
        connection.execute("DROP TABLE filler")
    full = path.stat().st_size

    GraphHistory(path).close()

    assert path.stat().st_size < full / 4


def test_schema_that_is_not_text_is_reported(original: Path, tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    content = original.read_bytes()
    assert b"tableposesposes" in content
    path.write_bytes(content.replace(b"tableposesposes", b"tablepos\xffspos\xffs"))

    for use in (GraphHistory, read_log, read_graph, lambda path: copy_graph(path, path)):
        with pytest.raises(CairnError, match=words_in_order(f"{path}: ", "damaged")):
            use(path)
