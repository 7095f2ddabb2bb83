"""Tests of `cairn map build`, as users type it."""

from __future__ import annotations

import gzip
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.slam.graph_file import read_graph
from cairn.planar.grid import FREE, OCCUPIED
from cairn.planar.map_file import read_map
from cairn.visual_map.landmark_store import open_landmarks
from tests.cairn.tools.mapping.relations import relation_errors
from tests.commands import cairn
from tests.disk import room_for

pytestmark = pytest.mark.slow

DATA = Path(__file__).parents[3] / "data" / "slam"
MRCLAM = DATA.parent / "mrclam" / "MRCLAM_Dataset6"
LOG, RELATIONS = DATA / "fr079_start.clf.gz", DATA / "fr079_start.relations"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the name of a map that was built from the real log."""
    out = tmp_path_factory.mktemp("map") / "fr079"
    answer = cairn("map", "build", str(LOG), str(out))
    assert answer.code == 0, answer.err
    assert "scans      1110, " in answer.out
    return out


def file(out: Path, ending: str) -> Path:
    return out.with_name(out.name + ending)


@pytest.mark.accuracy
def test_trajectory_keeps_the_times_of_the_recording_and_meets_the_benchmarks_accuracy(
    built: Path,
) -> None:
    with gzip.open(LOG, "rt") as lines:
        scans = [line.split() for line in lines if line.startswith("FLASER")]
    times = [words[2 + int(words[1]) + 6] for words in scans]

    written = file(built, ".tum").read_text().splitlines()

    assert [line.split()[0] for line in written] == times
    errors = relation_errors(file(built, ".tum"), RELATIONS)
    # Cartographer reaches 0.045 m and 0.54 deg on the whole log.
    assert errors.count == 268
    assert errors.position_m < 0.045
    assert errors.heading_deg < 0.9


@pytest.mark.accuracy
def test_grid_map_graph_and_picture_are_written(built: Path) -> None:
    grid = read_map(file(built, ".yaml"))

    width, height = grid.size_m
    assert 30 < width < 50
    assert 12 < height < 25
    assert np.mean(grid.values == FREE) > 0.2
    assert 0.005 < np.mean(grid.values == OCCUPIED) < 0.05
    assert file(built, ".png").read_bytes().startswith(b"\x89PNG")
    mapper = read_graph(file(built, ".graph"))
    assert len(mapper.keyframes) == len(mapper.graph.poses) > 400
    assert len(mapper.submaps) > 15


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return two parts of the log: the first 600 scans, and the others."""
    folder = tmp_path_factory.mktemp("parts")
    parts: tuple[list[str], list[str]] = ([], [])
    scans = 0
    with gzip.open(LOG, "rt") as lines:
        for line in lines:
            scans += line.startswith("FLASER")
            parts[scans > 600].append(line)
    paths = folder / "first.log", folder / "second.log"
    for path, part in zip(paths, parts, strict=True):
        path.write_text("".join(part))
    return paths


@pytest.fixture(scope="module")
def first(logs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the name of the map of the first part."""
    out = tmp_path_factory.mktemp("first") / "map"
    answer = cairn("map", "build", str(logs[0]), str(out), "--json")
    assert answer.code == 0
    out.with_name("result.json").write_text(answer.out)
    return out


@pytest.fixture(scope="module")
def short(logs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log of the first 200 scans, for what no loop is needed for."""
    path = tmp_path_factory.mktemp("short") / "short.log"
    lines: list[str] = []
    scans = 0
    for line in logs[0].read_text().splitlines(keepends=True):
        scans += line.startswith("FLASER")
        if scans <= 200:
            lines.append(line)
    path.write_text("".join(lines))
    return path


@pytest.mark.accuracy
def test_same_recording_gives_the_same_map_byte_for_byte(
    logs: tuple[Path, Path], first: Path, tmp_path: Path
) -> None:
    again = tmp_path / "map"

    assert cairn("map", "build", str(logs[0]), str(again)).code == 0

    for ending in (".yaml", ".pgm", ".tum"):
        assert file(again, ending).read_bytes() == file(first, ending).read_bytes()
    graphs = [read_graph(file(out, ".graph")).graph for out in (first, again)]
    assert np.array_equal(graphs[0].poses, graphs[1].poses)


@pytest.mark.accuracy
def test_second_recording_extends_the_map_of_the_first(
    logs: tuple[Path, Path], first: Path, tmp_path: Path
) -> None:
    both = tmp_path / "both"
    before = read_graph(file(first, ".graph"))

    answer = cairn(
        "map", "build", str(logs[1]), str(both), "--extend", str(file(first, ".graph")), "--json"
    )

    assert answer.code == 0, answer.err
    assert answer.json["left_out"] == 0
    after = read_graph(file(both, ".graph"))
    assert len(after.keyframes) > len(before.keyframes)
    assert after.in_map().all()
    # The old part stays where it was.
    moved = after.graph.poses[: len(before.keyframes)] - before.graph.poses
    assert np.hypot(moved[:, 0], moved[:, 1]).max() < 0.05
    both_days = tmp_path / "both_days.tum"
    both_days.write_text(file(first, ".tum").read_text() + file(both, ".tum").read_text())
    errors = relation_errors(both_days, RELATIONS)
    assert errors.position_m < 0.045


@pytest.mark.accuracy
def test_existing_map_is_kept_without_force(built: Path) -> None:
    before = file(built, ".pgm").read_bytes()

    answer = cairn("map", "build", str(LOG), str(built))

    assert answer.code == 1
    assert f"{file(built, '.yaml')} exists already" in answer.err
    assert file(built, ".pgm").read_bytes() == before


@pytest.mark.accuracy
def test_map_before_is_kept_if_the_new_one_cannot_be_written(
    short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "map"
    for ending in (".yaml", ".pgm", ".graph"):
        file(out, ending).write_text("the map before")

    def full(*_arguments: object) -> None:
        raise CairnError("no space left on device")

    monkeypatch.setattr("cairn.tools.mapping.cli.write_map", full)

    answer = cairn("map", "build", str(short), str(out), "--force")

    assert answer.code == 1
    assert "no space left" in answer.err
    for ending in (".yaml", ".pgm", ".graph"):
        assert file(out, ending).read_text() == "the map before"


@pytest.mark.accuracy
def test_full_disk_leaves_the_whole_map_before(short: Path, tmp_path: Path) -> None:
    """The grid map has room, but not the graph to which it belongs."""
    out = tmp_path / "map"
    for ending in (".yaml", ".pgm", ".graph", ".png"):
        file(out, ending).write_text("the map before")

    with room_for(600_000):
        answer = cairn("map", "build", str(short), str(out), "--force")

    assert answer.code == 1
    assert f"cairn: {file(out, '.graph')}: " in answer.err
    assert "free disk space" in answer.err
    assert {one.read_text() for one in tmp_path.iterdir()} == {"the map before"}
    assert len(list(tmp_path.iterdir())) == 4


@pytest.fixture(scope="module")
def without_odometry(logs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log whose scans have no poses: the first 300, which show 60 s of driving."""
    path = tmp_path_factory.mktemp("bare") / "bare.log"
    lines: list[str] = []
    for line in logs[0].read_text().splitlines():
        words = line.split()
        if words[0] != "FLASER" or len(lines) == 300:
            continue
        count = int(words[1])
        ranges = words[2 : 2 + count]
        step = math.radians(0.5)
        head = ["RAWLASER1", "0", str(-math.pi / 2), str(math.pi), str(step), "81.9", "0.01", "0"]
        lines.append(" ".join([*head, str(count), *ranges, "0", *words[-3:]]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_recording_without_odometry_is_refused_with_the_remedy(
    without_odometry: Path, tmp_path: Path
) -> None:
    answer = cairn("map", "build", str(without_odometry), str(tmp_path / "map"))

    assert answer.code == 1
    assert "has no odometry; give --scan-only" in answer.err
    assert not list(tmp_path.iterdir())


@pytest.mark.accuracy
def test_scans_alone_give_a_map_of_a_slow_robot(
    built: Path, without_odometry: Path, tmp_path: Path
) -> None:
    out = tmp_path / "map"

    answer = cairn("map", "build", str(without_odometry), str(out), "--scan-only", "--json")

    assert answer.code == 0, answer.err
    assert answer.json["scans"] == 300
    alone = np.loadtxt(file(out, ".tum"))
    with_odometry = np.loadtxt(file(built, ".tum"))[:300]
    assert np.abs(alone[:, 1:3] - with_odometry[:, 1:3]).max() < 0.15


def test_recording_without_scans_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "odometry.log"
    path.write_text("".join(f"ODOM {k / 10} 0 0 1 0 0 {k / 10} host {k / 10}\n" for k in range(50)))

    answer = cairn("map", "build", str(path), str(tmp_path / "map"))

    assert answer.code == 1
    assert f"{path}: has no scans and no observations of objects" in answer.err


@pytest.mark.accuracy
def test_result_is_printed_as_json(first: Path) -> None:
    result = json.loads(first.with_name("result.json").read_text())

    assert result["loops"] > 3
    assert 0.95 < result["on_walls"] <= 1.0
    assert result["fit"] > 0.8


@pytest.mark.accuracy
def test_objects_alone_give_a_visual_map(tmp_path: Path) -> None:
    out = tmp_path / "mrclam"

    answer = cairn("map", "build", str(MRCLAM), str(out), "--robot", "2", "--json")

    assert answer.code == 0, answer.err
    assert answer.json["landmarks"] == 15
    assert not file(out, ".yaml").exists()
    with open_landmarks(file(out, ".cairn"), read_only=True) as store:
        landmarks = list(store.landmarks())
    assert {one.reliability for one in landmarks} == {0.5}
    for one in landmarks:
        assert one.position is not None
        assert 0.0 < one.position.xx < 0.05


@pytest.mark.accuracy
def test_wrong_mount_is_named_with_the_yaw_that_motion_shows(short: Path, tmp_path: Path) -> None:
    answer = cairn("map", "build", str(short), str(tmp_path / "map"), "--scanner", "0,0,1.57")

    assert "is the mount of the scanner, (0, 0, 1.57), right?" in answer.err
    assert re.search(r"Try --scanner 0,0,-?0\.0\d$", answer.err, re.MULTILINE)


def test_map_with_too_many_cells_is_drawn_with_larger_ones(
    short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.tools.mapping.build.MOST_CELLS", 600_000)

    answer = cairn("map", "build", str(short), str(tmp_path / "map"))

    assert answer.code == 0, answer.err
    assert "cells of 0.1 m; with cells of 0.05 m, it would have more than 600,000" in answer.err
    assert read_map(tmp_path / "map.yaml").frame.resolution == 0.1
