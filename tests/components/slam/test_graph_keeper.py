"""Map builder and graph keeper in lockstep: a table is moved, and the graph follows."""

import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError, from_ns
from cairn.components.map_builder.component import MapBuilder
from cairn.components.slam.graph_history import GraphHistory, draw_state, read_log
from cairn.components.slam.graph_keeper import GraphKeeper
from cairn.planar.grid import OCCUPIED, OccupancyCells
from cairn.planar.map_file import read_map, write_map
from cairn.planar.messages import with_covariance
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness, Lockstep
from tests.commands import cairn
from tests.components.localizer.room import RESOLUTION, room
from tests.components.slam.changing_room import (
    MOVED,
    REACH,
    ROUND,
    TABLE,
    scan_at,
    write_room_graph,
)
from tests.disk import room_for
from tests.wording import assert_words

BEGIN = 1000.0
PERMANENT = 60.0


@pytest.fixture
def original(tmp_path: Path) -> Path:
    """The graph of a room with a table, and its grid map beside it."""
    path = tmp_path / "room.graph"
    write_room_graph(path, [TABLE])
    with GraphHistory(path) as history:
        grid = draw_state(history.state(), RESOLUTION).grid()
        history.seal()
    write_map(path.with_suffix(".yaml"), grid)
    return path


class Robot:
    """A map builder and a graph keeper, and a robot that drives rounds in a room."""

    def __init__(
        self,
        original: Path,
        *,
        start_s: float = BEGIN,
        permanent_s: float = PERMANENT,
        simulated_time: bool = False,
    ):
        self._simulated_time = simulated_time
        self.copy = original.with_name("report.graph")
        self.builder = ComponentHarness(
            MapBuilder,
            {"grid_file": str(original.with_suffix(".yaml"))},
            start_s=start_s,
            simulated_time=simulated_time,
        )
        self.keeper = ComponentHarness(
            GraphKeeper,
            {
                "graph_file": str(original),
                "working_copy": str(self.copy),
                "permanent_s": permanent_s,
                "scans_per_s": 5.0,
            },
            beside=self.builder,
            simulated_time=simulated_time,
        )
        self._random = np.random.default_rng(0)

    def drive(self, world: OccupancyCells, rounds: int, health: float = 1.0) -> None:
        """Drive rounds of 24 poses; the robot takes five scans in a second at each."""
        bus: Lockstep = self.builder
        for _ in range(rounds):
            for pose in ROUND:
                for _ in range(5):
                    bus.run_for(0.2)
                    if self._simulated_time:
                        bus.publish("clock", Clock(clock=from_ns(bus.now_ns)))
                    self._scan(bus, world, pose, health)
        bus.run_for(1.0)

    def _scan(self, bus: Lockstep, world: OccupancyCells, pose: Pose, health: float) -> None:
        rays = scan_at(world, pose, self._random)
        step = float(rays.angles[1] - rays.angles[0])
        header = Header(stamp=from_ns(bus.now_ns), frame_id="map")
        bus.publish("odom", Odometry(header=header))
        bus.publish(
            "scan",
            LaserScan(
                header=header,
                angle_min=float(rays.angles[0]),
                angle_max=float(rays.angles[-1]),
                angle_increment=step,
                range_min=0.05,
                range_max=REACH,
                ranges=rays.ranges.astype(np.float32),
            ),
        )
        covariance = np.diag([0.02**2, 0.02**2, 0.005**2])
        bus.publish(
            "localization",
            LocalizationEstimate(
                header=header,
                located=True,
                pose=with_covariance(pose, covariance),
                health=health,
                position_sd=0.03,
                heading_sd=0.005,
            ),
        )


def drawn(path: Path, version: int | None = None) -> OccupancyCells:
    with GraphHistory(path) as history:
        return draw_state(history.state(version), RESOLUTION).grid()


def obstacle_near(grid: OccupancyCells, x: float, y: float) -> bool:
    row, column = grid.frame.cell(x, y)
    return bool((grid.values[row - 2 : row + 3, column - 2 : column + 3] == OCCUPIED).any())


@pytest.mark.accuracy
def test_moved_table_is_in_the_graph_and_in_the_history_and_rollback_restores_it(
    original: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    robot, before = Robot(original), original.read_bytes()
    robot.drive(room((TABLE,)), 1)
    assert robot.keeper.request("status")["version"] == 0

    robot.drive(room((MOVED,)), 10)

    status = robot.keeper.request("status")
    assert status["version"] > 0
    assert "changed the graph: version 1, " in caplog.text
    robot.keeper.request("deactivate")
    moved = drawn(robot.copy)
    assert not obstacle_near(moved, 4.75, 3.05)
    assert obstacle_near(moved, 3.75, 3.85)
    assert original.read_bytes() == before
    answer = cairn("map", "history", str(robot.copy), "--json")
    assert answer.json["version"] == status["version"]
    first = answer.json["changes"][0]
    assert first["kind"] in ("changed", "removed", "added")
    assert math.hypot(first["x"] - 4.25, first["y"] - 3.7) < 1.5
    assert first["time"].startswith("1970-01-01 00:1")

    answer = cairn("map", "rollback", str(robot.copy), "0", "--json")

    assert answer.json["returned_to"] == 0
    assert answer.json["version"] == status["version"] + 1
    restored = read_map(robot.copy.with_suffix(".yaml"))
    assert obstacle_near(restored, 4.75, 3.05)
    assert not obstacle_near(restored, 3.75, 3.85)
    assert np.array_equal(restored.values, drawn(original).values)


@pytest.mark.accuracy
def test_restarted_keeper_continues_its_copy(
    original: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    first = Robot(original)
    first.drive(room((MOVED,)), 5)
    version = first.keeper.request("status")["version"]
    assert version > 0
    first.keeper.request("deactivate")

    again = Robot(original, start_s=BEGIN + 500.0)
    again.drive(room((MOVED,)), 1)
    assert again.keeper.request("status")["version"] == version
    assert "reusing the working copy" in caplog.text
    again.keeper.request("deactivate")

    # The clock was set back: nothing learned is lost.
    set_back = Robot(original, start_s=BEGIN)
    set_back.drive(room((MOVED,)), 1)
    assert set_back.keeper.request("status")["version"] == version
    assert "replacing the working copy" not in caplog.text
    set_back.keeper.request("deactivate")

    # Another replay of the same time starts from the original.
    other = Robot(original, start_s=BEGIN, simulated_time=True)
    other.drive(room((TABLE,)), 1)
    assert other.keeper.request("status")["version"] == 0
    assert "replacing the working copy" in caplog.text


def test_damaged_copy_is_set_aside_and_replaced(
    original: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copy, damaged = original.with_name("report.graph"), b"not a graph" * 1000
    copy.write_bytes(damaged)

    robot = Robot(original)
    robot.drive(room((TABLE,)), 1)

    assert robot.keeper.request("status")["keyframes"] == len(ROUND)
    kept = original.with_name("report.damaged.graph")
    assert_words(caplog.text, f"{copy} cannot be used", "not a graph", f"it is kept as {kept}")
    assert kept.read_bytes() == damaged


def test_full_disk_delays_the_copy_and_fails_nothing(
    original: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with room_for(5_000):
        robot = Robot(original)
        robot.drive(room((TABLE,)), 1)
        with pytest.raises(CairnError, match="has no map yet"):
            robot.keeper.request("status")
    assert "graph not saved" in caplog.text

    robot.drive(room((TABLE,)), 1)

    assert robot.keeper.request("status")["keyframes"] == len(ROUND)
    assert robot.keeper.ends == []


@pytest.mark.accuracy
def test_unreliable_poses_change_nothing(original: Path) -> None:
    robot = Robot(original)
    robot.drive(room((MOVED,)), 2)  # the map builder repairs the grid map
    version = robot.keeper.request("status")["version"]
    assert robot.keeper.request("status")["pending"] > 0

    robot.drive(room((MOVED,)), 4, health=0.5)

    assert robot.keeper.request("status")["version"] == version == 0


def test_graph_that_is_none_fails_configuration(tmp_path: Path) -> None:
    file = tmp_path / "none.graph"
    parameters = {"graph_file": str(file), "working_copy": str(tmp_path / "copy.graph")}
    with pytest.raises(CairnError, match=r"none\.graph: no such file"):
        ComponentHarness(GraphKeeper, parameters)
    file.write_bytes(b"SQLite format 3\0" + bytes(5000))
    with pytest.raises(CairnError, match=r"none\.graph"):
        ComponentHarness(GraphKeeper, parameters)


@pytest.mark.accuracy
def test_kill_loses_no_change_that_was_logged(original: Path) -> None:
    program = f"""
import logging, sys
from pathlib import Path
from tests.components.slam.test_graph_keeper import MOVED, Robot, room
logging.basicConfig(level="INFO", stream=sys.stdout)
robot = Robot(Path({str(original)!r}))
robot.drive(room((MOVED,)), 9)
"""
    with subprocess.Popen(
        [sys.executable, "-u", "-c", program], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        logged = next(line for line in process.stdout if "changed the graph: version 1," in line)
        os.kill(process.pid, signal.SIGKILL)

    assert logged
    copy = original.with_name("report.graph")
    log = read_log(copy)
    assert log.version >= 1
    first = log.changes[0][1]
    assert first.added + first.removed > 0
    before, after = drawn(copy, 0), drawn(copy, 1)
    assert np.count_nonzero(before.values == OCCUPIED) != np.count_nonzero(after.values == OCCUPIED)
