"""Tests of the component's grid map: updates, reliable poses only, working copy."""

import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import SECOND, CairnError, from_ns
from cairn.components.map_builder.component import MapBuilder
from cairn.planar.grid import FREE, OCCUPIED, Grid, grid_of
from cairn.planar.map_file import read_map, write_map
from cairn.planar.messages import with_covariance
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.components.localizer.room import ROOM, Box, room, scanned
from tests.disk import room_for
from tests.sweeps import sampled
from tests.wording import assert_words, words_in_order

BEGIN = 1000.0
HERE: Pose = (2.0, 2.0, 0.0)
NEW: Box = (3.5, 1.7, 3.9, 2.3)


def scan_of(world: Grid[np.int8], stamp: Header, random: np.random.Generator) -> LaserScan:
    points = scanned(world, HERE, random, beams=241, reach=9.0)
    ranges = np.full(241, np.inf, np.float32)
    step = math.radians(1.0)
    number = np.rint((np.arctan2(points[:, 1], points[:, 0]) + 120 * step) / step).astype(int)
    ranges[number] = np.hypot(points[:, 0], points[:, 1])
    return LaserScan(
        header=stamp,
        angle_min=-120 * step,
        angle_max=120 * step,
        angle_increment=step,
        range_min=0.05,
        range_max=9.0,
        ranges=ranges,
    )


def watch(it: Any, world: Grid[np.int8], seconds: float, sd: float = 0.02, back_s: int = 0) -> None:
    """Let the robot stand and scan the world, with a position known to `sd` [m].

    All stamps are set back by `back_s` [s].
    """
    random = np.random.default_rng(0)
    began = it.now_ns
    for k in range(round(seconds / 0.2)):
        it.run_for(max(0.0, (began + k * 200_000_000 - it.now_ns) / 1e9))
        stamp = from_ns(it.now_ns - back_s * SECOND)
        header = Header(stamp=stamp, frame_id="map")
        it.publish("odom", Odometry(header=header))
        it.publish("scan", scan_of(world, header, random))
        published = with_covariance(HERE, np.diag([sd**2, sd**2, 0.01**2]))
        it.publish(
            "localization",
            LocalizationEstimate(
                header=header,
                located=True,
                pose=published,
                health=1.0,
                position_sd=sd,
                heading_sd=0.01,
            ),
        )


@pytest.fixture
def grid_file(tmp_path: Path) -> Path:
    file = tmp_path / "map.yaml"
    write_map(file, room())
    return file


def test_map_is_latched_and_changes_are_published_as_windows(grid_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"grid_file": str(grid_file)}, start_s=BEGIN)
    (first,) = it.take("map")
    assert np.array_equal(grid_of(first).values, room().values)

    watch(it, room((*ROOM, NEW)), 15.0)
    it.run_for(6.0)

    updates = it.take("map_updates")
    assert updates
    assembled = np.array(grid_of(first).values)
    for update in updates:
        rows = slice(update.y, update.y + update.height)
        columns = slice(update.x, update.x + update.width)
        assembled[rows, columns] = update.data.reshape(update.height, update.width)
    last = grid_of(it.take("map")[-1]).values
    assert np.array_equal(assembled, last)
    row, column = first_cell = (40, 70)
    assert last[row, column] == OCCUPIED, first_cell
    assert grid_of(first).values[row, column] == FREE


def test_unreliable_pose_pauses_updates_and_is_logged(
    grid_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    it = ComponentHarness(MapBuilder, {"grid_file": str(grid_file)}, start_s=BEGIN)
    watch(it, room(), 1.0)

    watch(it, room((*ROOM, NEW)), 15.0, sd=0.4)

    assert it.take("map_updates") == []
    assert_words(caplog.text, "paused", "grid map", "0.40 m")


def test_clock_set_back_is_logged_once_and_updates_continue(
    grid_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    it = ComponentHarness(MapBuilder, {"grid_file": str(grid_file)}, start_s=BEGIN)
    watch(it, room(), 5.0)
    it.take("map")

    watch(it, room((*ROOM, NEW)), 15.0, back_s=600)
    it.run_for(6.0)

    assert caplog.text.count("odometry on /robot/odom went back in time") == 1
    assert grid_of(it.take("map")[-1]).values[40, 70] == OCCUPIED


def test_restarted_map_builder_reuses_its_working_copy(grid_file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.yaml"
    first = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN
    )
    watch(first, room((*ROOM, NEW)), 15.0)
    first.request("deactivate")

    again = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN + 20.0
    )
    (published,) = again.take("map")
    assert grid_of(published).values[40, 70] == OCCUPIED
    assert np.array_equal(read_map(copy).values, grid_of(published).values)
    assert np.array_equal(read_map(grid_file).values, room().values)

    set_back = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN - 500.0
    )
    (published,) = set_back.take("map")
    assert grid_of(published).values[40, 70] == OCCUPIED  # what was learned is not lost

    replay = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, simulated_time=True
    )
    replay.publish("clock", Clock(clock=from_ns(round((BEGIN - 500.0) * SECOND))))
    replay.publish("clock", Clock(clock=from_ns(round((BEGIN - 490.0) * SECOND))))
    (published,) = replay.take("map")
    assert grid_of(published).values[40, 70] == FREE  # the copy is of another replay


def test_missing_folder_gives_rate_limited_warnings_until_it_is_back(
    grid_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "kept"
    folder.mkdir()
    copy = folder / "copy.yaml"
    it = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN
    )
    shutil.rmtree(folder)

    watch(it, room((*ROOM, NEW)), 15.0)
    it.run_for(100.0)

    published = [line for line in caplog.messages if "grid map not saved" in line]
    assert 2 <= len(published) <= 4
    assert "No such file" in published[0]
    assert it.ends == []
    last = grid_of(it.take("map")[-1]).values
    assert last[40, 70] == OCCUPIED

    folder.mkdir()
    it.run_for(11.0)
    assert np.array_equal(read_map(copy).values, last)


def test_unwritable_origin_file_does_not_stop_the_map_builder(
    grid_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copy = tmp_path / "copy.yaml"
    it = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN
    )
    (tmp_path / "copy.origin.json").mkdir()
    watch(it, room((*ROOM, NEW)), 15.0)
    it.request("deactivate")

    assert "copy.origin.json cannot be written: Is a directory" in caplog.text
    assert it.ends == []


def test_full_disk_leaves_the_last_copy_intact(
    grid_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copy = tmp_path / "copy.yaml"
    first = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN
    )
    watch(first, room((*ROOM, NEW)), 15.0)
    first.request("deactivate")
    written = read_map(copy).values

    again = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN + 20.0
    )
    watch(again, room(), 8.0)
    with room_for(1000):
        again.request("deactivate")

    assert "grid map not saved" in caplog.text
    assert "File too large" in caplog.text
    assert np.array_equal(read_map(copy).values, written)


@pytest.mark.parametrize(
    ("file", "content", "why"),
    sampled(
        [
            ("copy.origin.json", b"", r"copy\.origin\.json is not valid"),
            ("copy.origin.json", b'{"source": "\xff', r"copy\.origin\.json is not valid"),
            ("copy.pgm", b"P5\n180 140\n255\nshort", r"copy\.pgm: is truncated or damaged"),
            ("copy.pgm", None, r"copy\.pgm: no such image"),
            ("copy.yaml", b"", r"copy\.yaml: not a map_server YAML file"),
            ("map.pgm", b"", None),
        ],
        2,
    ),
)
def test_unusable_copy_is_reported_set_aside_and_replaced(
    grid_file: Path,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    file: str,
    content: bytes | None,
    why: str | None,
) -> None:
    caplog.set_level("INFO")
    copy = tmp_path / "copy.yaml"
    first = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN
    )
    watch(first, room((*ROOM, NEW)), 15.0)
    first.request("deactivate")
    if file == "map.pgm":  # edited by hand
        write_map(grid_file, room(ROOM[:2]))
    elif content is None:
        (tmp_path / file).unlink()
    else:
        (tmp_path / file).write_bytes(content)
    damaged = ".damaged.".join(file.rsplit(".", 1))

    again = ComponentHarness(
        MapBuilder, {"grid_file": str(grid_file), "grid_copy": str(copy)}, start_s=BEGIN + 20.0
    )

    (published,) = again.take("map")
    assert np.array_equal(grid_of(published).values, read_map(grid_file).values)
    (line,) = [line for line in caplog.messages if "copy.yaml" in line]
    if why is None:
        assert re.search(r"replacing the working copy .*: it is a copy of another map", line)
    else:
        kept = r"it is kept as .*copy\.damaged\.yaml"
        assert re.search(rf"copy\.yaml cannot be used: .*{why}.*; {kept}", line)
        assert content is None or (tmp_path / damaged).read_bytes() == content


def test_missing_map_fails_configuration(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"none\.yaml: no such file"):
        ComponentHarness(MapBuilder, {"grid_file": str(tmp_path / "none.yaml")}, start_s=BEGIN)
    with pytest.raises(CairnError, match=words_in_order("map_file", "grid_file")):
        ComponentHarness(MapBuilder, start_s=BEGIN, activate=False)


def test_pose_without_a_scan_changes_nothing(grid_file: Path) -> None:
    it = ComponentHarness(MapBuilder, {"grid_file": str(grid_file)}, start_s=BEGIN)
    header = Header(stamp=from_ns(it.now_ns), frame_id="map")
    published = with_covariance(HERE, np.diag([1e-4, 1e-4, 1e-4]))

    it.publish(
        "localization",
        LocalizationEstimate(header=header, located=True, pose=published, health=1.0),
    )
    it.run_for(3.0)

    assert it.take("map_updates") == []
