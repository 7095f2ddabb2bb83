"""Tests of graph files: they are read as they were written, and damaged ones are refused."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.slam import graph_file
from cairn.components.slam.graph_file import GraphFile, read_graph, write_graph
from cairn.components.slam.mapping import Mapper
from cairn.components.slam.pose_graph import Sighting
from tests.components.slam.box_room import drive


def assert_same(one: Mapper, other: Mapper) -> None:
    """Assert that two mappers have the same graph; points are kept to a tenth of a millimeter."""
    assert np.array_equal(one.graph.poses, other.graph.poses)
    assert [(s.number, s.first, s.last) for s in one.submaps] == [
        (s.number, s.first, s.last) for s in other.submaps
    ]
    assert one.graph.landmarks == other.graph.landmarks
    assert one.graph.sightings == other.graph.sightings
    for a, b in zip(one.graph.edges, other.graph.edges, strict=True):
        assert (a.kind, a.first, a.second, a.measured) == (b.kind, b.first, b.second, b.measured)
        assert np.array_equal(a.information, b.information)
    for first, second in zip(one.keyframes, other.keyframes, strict=True):
        assert (first.stamp_ns, first.odometry, first.submap) == (
            second.stamp_ns,
            second.odometry,
            second.submap,
        )
        assert np.allclose(first.cloud.points, second.cloud.points, atol=1e-4)
        assert first.rays is not None
        assert second.rays is not None
        assert np.array_equal(first.rays.ranges, second.rays.ranges)
        assert first.rays.first == second.rays.first


@pytest.fixture
def mapper() -> Mapper:
    mapper = Mapper(10.0)
    drive(mapper, 0, 30)
    return mapper


def test_graph_is_read_as_it_was_written(mapper: Mapper, tmp_path: Path) -> None:
    mapper.graph.add_sighting(Sighting(3, 7, 1.5, 0.2, 0.1, 0.02))
    path = tmp_path / "room.graph"

    write_graph(path, mapper, "a test")

    assert_same(read_graph(path), mapper)
    assert [file.name for file in tmp_path.iterdir()] == ["room.graph"]


def test_extension_that_recognizes_no_place_leaves_the_map_as_it_is(
    mapper: Mapper, tmp_path: Path
) -> None:
    old = len(mapper.keyframes)
    mapper.resume(here=False)
    drive(mapper, 100, 190, boxes=((9.0, -2.0, 20.0, 2.5), (12.0, 0.5, 15.0, 1.0)))
    mapper.finish()
    write_graph(tmp_path / "room.graph", mapper, "a test")

    for read in (mapper, read_graph(tmp_path / "room.graph")):
        assert len(read.keyframes) > 2 * old
        assert read.in_map().tolist() == [k < old for k in range(len(read.keyframes))]


def test_killed_writer_loses_only_what_was_not_saved(mapper: Mapper, tmp_path: Path) -> None:
    path, copy = tmp_path / "room.graph", tmp_path / "killed"
    file = GraphFile.create(path, mapper.farthest, "a test")
    file.save(mapper)
    drive(mapper, 30, 40)
    file.save(mapper)
    saved = len(mapper.keyframes)
    drive(mapper, 40, 45)
    # What the disk has while the writer is still open is what a killed one leaves.
    shutil.copytree(tmp_path, copy)
    file.close()

    left = read_graph(copy / "room.graph")

    assert len(left.keyframes) == saved < len(mapper.keyframes)
    assert np.array_equal(left.graph.poses, mapper.graph.poses[:saved])


def test_file_that_is_saved_again_follows_changed_poses_and_edges(
    mapper: Mapper, tmp_path: Path
) -> None:
    path = tmp_path / "room.graph"
    file = GraphFile.create(path, mapper.farthest, "a test")
    with closing(file):
        file.save(mapper)
        mapper.graph.poses = mapper.graph.poses + np.array([0.01, 0.0, 0.0])
        del mapper.graph.edges[2]
        file.save(mapper)

    assert_same(read_graph(path), mapper)


def test_file_that_is_saved_again_follows_a_sighting_that_was_replaced(
    mapper: Mapper, tmp_path: Path
) -> None:
    path = tmp_path / "room.graph"
    file = GraphFile.create(path, mapper.farthest, "a test")
    with closing(file):
        for keyframe in (2, 3):
            mapper.graph.add_sighting(Sighting(keyframe, 7, 1.5, 0.2, 0.1, 0.02))
        file.save(mapper)
        mapper.graph.sightings[1] = Sighting(3, 7, 1.4, 0.2, 0.1, 0.02)
        mapper.graph.add_sighting(Sighting(4, 7, 1.5, 0.2, 0.1, 0.02))
        file.save(mapper)

    assert_same(read_graph(path), mapper)


def test_robot_continues_where_it_was_after_a_restart(mapper: Mapper, tmp_path: Path) -> None:
    path = tmp_path / "room.graph"
    file = GraphFile.create(path, mapper.farthest, "a test")
    file.save(mapper)
    file.close()

    file, restored = GraphFile.open(path)
    restored.resume(here=True)
    drive(restored, 32, 40)
    file.save(restored)
    file.close()

    assert restored.is_located
    assert restored.pose == pytest.approx((3.9, 0.0, 0.0), abs=0.03)
    assert_same(read_graph(path), restored)


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        ("DELETE FROM keyframes WHERE number = 1", "keyframes are missing"),
        ("DELETE FROM poses WHERE number = 1", "poses are missing"),
        ("UPDATE poses SET x = 1e300 WHERE number = 1", "poses are missing or not finite"),
        ("UPDATE edges SET second = 4000 WHERE number = 0", "constraint 0, 4000 is missing"),
        ("UPDATE edges SET kind = 9 WHERE number = 0", "9 is not a valid EdgeKind"),
        ("UPDATE edges SET measured = x'00' WHERE number = 0", "damaged graph"),
        ("UPDATE keyframes SET cloud = x'0000c07f' WHERE number = 0", "damaged graph"),
        ("UPDATE submaps SET last = 'end'", "is wrong"),
        ("DROP TABLE edges", "tables are missing"),
        ("CREATE TRIGGER t AFTER INSERT ON edges BEGIN DELETE FROM poses; END", "trigger"),
    ],
)
def test_damaged_file_is_refused_by_name(
    mapper: Mapper, tmp_path: Path, damage: str, fault: str
) -> None:
    path = tmp_path / "room.graph"
    mapper.finish()
    write_graph(path, mapper, "a test")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(damage)

    with pytest.raises(CairnError, match=fault) as caught:
        read_graph(path)

    assert str(path) in str(caught.value)


def test_other_files_are_refused_by_name(tmp_path: Path) -> None:
    text, missing, map_file = tmp_path / "a.graph", tmp_path / "b.graph", tmp_path / "c.graph"
    text.write_text("not a graph")
    with closing(sqlite3.connect(map_file)) as connection, connection:
        connection.execute("CREATE TABLE poses (x REAL)")

    for path, fault in (
        (text, "not a graph"),
        (missing, "no such file"),
        (map_file, "not a graph"),
    ):
        with pytest.raises(CairnError, match=fault):
            read_graph(path)


def test_file_is_created_completely_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A component that is killed meanwhile could not continue half of a file."""
    monkeypatch.setitem(graph_file._TABLES, "landmarks", "landmark INTEGER PRIMARY KEY, x x y,")

    with pytest.raises(CairnError, match="syntax error"):
        GraphFile.create(tmp_path / "map.graph", 10.0, "a test")

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        ("UPDATE edges SET information = :numbers WHERE number = 1", "information"),
        ("UPDATE edges SET information = :nothing WHERE number = 1", "information"),
        ("INSERT INTO landmarks VALUES (1, 0, 0)", "deviations of sighting 0"),
    ],
)
def test_uncertainties_that_are_not_possible_are_refused(
    mapper: Mapper, tmp_path: Path, damage: str, fault: str
) -> None:
    path = tmp_path / "room.graph"
    write_graph(path, mapper, "a test")
    with closing(sqlite3.connect(path)) as connection, connection:
        numbers = {"numbers": (-np.eye(3)).tobytes(), "nothing": np.zeros((3, 3)).tobytes()}
        connection.execute(damage, numbers)
        connection.execute("INSERT INTO sightings VALUES (0, 0, 1, ?)", (np.zeros(4).tobytes(),))

    with pytest.raises(CairnError, match=f"damaged graph: .*{fault}"):
        read_graph(path)


def test_graph_that_slam_has_closed_is_read_without_writing_beside_it(
    mapper: Mapper, tmp_path: Path
) -> None:
    """So it can be read in a folder in which only others may write."""
    file = GraphFile.create(tmp_path / "map.graph", 10.0, "a test")
    file.save(mapper)
    file.close()

    assert len(read_graph(tmp_path / "map.graph").keyframes) == len(mapper.keyframes)

    assert [one.name for one in tmp_path.iterdir()] == ["map.graph"]
