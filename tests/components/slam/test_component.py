"""Tests of the component Slam in lockstep: it maps, localizes, saves, and survives a kill."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from cairn import CairnError, from_ns
from cairn.components.slam.component import Slam
from cairn.components.slam.graph_file import GraphFile, read_graph, write_graph
from cairn.components.slam.mapping import Mapper
from cairn.planar.grid import FREE, OCCUPIED, grid_of
from cairn.planar.map_file import read_map
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from tests.components.slam.box_room import ANGLES, SECOND, drive, scan

STEP_S = 0.1


class Driver:
    """Drives a robot straight ahead at 0.5 m/s, with odometry that is 4 % too long."""

    def __init__(self, slam: ComponentHarness[Slam]) -> None:
        self._slam = slam
        self.true: Pose = (0.0, 0.0, 0.0)
        self.odometry: Pose = (0.0, 0.0, 0.0)
        self.covered = False
        self.time_s: float | None = None  # of topic `clock`, if slam takes its time from there

    def drive(self, steps: int, speed: float = 0.5) -> None:
        for _ in range(steps):
            x, y, theta = self.true
            self.true = (x + speed * STEP_S, y, theta)
            x, y, theta = self.odometry
            self.odometry = (x + 1.04 * speed * STEP_S, y, theta)
            self.stand()

    def stand(self) -> None:
        """Publish odometry and a scan from where the robot is, a tenth of a second later."""
        self._slam.run_for(STEP_S)
        now = self._slam.now_ns
        if self.time_s is not None:
            self.time_s += STEP_S
            now = round(self.time_s * SECOND)
            self._slam.publish("clock", Clock(clock=from_ns(now)))
        header = Header(stamp=from_ns(now), frame_id="odom")
        pose = PoseWithCovariance(pose=pose_message(self.odometry))
        self._slam.publish("odom", Odometry(header=header, child_frame_id="base_link", pose=pose))
        ranges = scan(self.true).ranges.astype(np.float32)
        if self.covered:
            ranges[:] = math.nan
        self._slam.publish(
            "scan",
            LaserScan(
                header=Header(stamp=header.stamp, frame_id="laser"),
                angle_min=float(ANGLES[0]),
                angle_max=float(ANGLES[-1]),
                angle_increment=float(ANGLES[1] - ANGLES[0]),
                range_min=0.05,
                range_max=10.0,
                ranges=ranges,
            ),
        )


@pytest.fixture
def slam(tmp_path: Path) -> ComponentHarness[Slam]:
    return ComponentHarness(Slam, {"map_file": str(tmp_path / "map.yaml")}, start_s=100.0)


def last_pose(slam: ComponentHarness[Slam]) -> Pose:
    return planar_pose(slam.take("localization")[-1].pose.pose)


def test_pose_follows_the_scans_where_odometry_is_wrong(slam: ComponentHarness[Slam]) -> None:
    robot = Driver(slam)
    robot.stand()

    robot.drive(50)

    assert robot.odometry[0] - robot.true[0] > 0.09
    assert last_pose(slam) == pytest.approx(robot.true, abs=0.02)
    estimates = slam.take("pose")
    assert len(estimates) == 51
    (transform,) = slam.take("tf")[-1].transforms
    assert transform.child_frame_id == "odom"
    assert transform.transform.translation.x == pytest.approx(-0.1, abs=0.03)


def test_published_map_shows_the_room_and_updates_keep_a_copy_current(
    slam: ComponentHarness[Slam],
) -> None:
    robot = Driver(slam)
    robot.drive(20)
    copy = None
    for message in slam.take("map"):
        copy = grid_of(message)
    assert copy is not None
    values = copy.values.copy()

    robot.drive(30)
    slam.run_for(3.0)

    for update in slam.take("map_updates"):
        window = values[update.y : update.y + update.height, update.x : update.x + update.width]
        window[:] = update.data.reshape(update.height, update.width)
    newest = grid_of(slam.take("map")[-1])
    assert newest.frame == copy.frame
    assert np.array_equal(values, newest.values)
    row, column = newest.frame.cell(1.5, 0.5)
    assert newest.values[row, column] == FREE
    row, column = newest.frame.cell(2.5, 1.5)
    assert OCCUPIED in newest.values[row - 1 : row + 2, column - 1 : column + 2]


def test_map_is_written_on_request_and_at_the_end(
    slam: ComponentHarness[Slam], tmp_path: Path
) -> None:
    robot = Driver(slam)
    with pytest.raises(CairnError, match="has no map yet"):
        slam.request("save")
    robot.drive(20)

    files = slam.request("save")["files"]

    assert [Path(file).name for file in files] == ["map.yaml", "map.pgm", "map.graph"]
    saved = read_map(tmp_path / "map.yaml")
    assert np.mean(saved.values == FREE) > 0.2
    robot.drive(20)
    slam.request("deactivate")
    assert len(read_graph(tmp_path / "map.graph").keyframes) >= 9


def mapped_files(folder: Path) -> dict[str, bytes]:
    """Return the files of a drive along walls and an object."""
    folder.mkdir()
    slam = ComponentHarness(Slam, {"map_file": str(folder / "map.yaml")}, start_s=100.0, seed=1)
    robot = Driver(slam)
    for _ in range(50):
        robot.drive(1)
        dx, dy = 3.0 - robot.true[0], 0.5 - robot.true[1]
        seen = RecognizedObject(object_id=7, range=math.hypot(dx, dy), bearing=math.atan2(dy, dx))
        header = Header(stamp=from_ns(slam.now_ns), frame_id="base_link")
        slam.publish("objects", RecognizedObjectArray(header=header, objects=(seen,)))
    slam.request("save")
    slam.request("deactivate")
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_same_drive_gives_the_same_files_byte_for_byte(tmp_path: Path) -> None:
    first, second = mapped_files(tmp_path / "first"), mapped_files(tmp_path / "second")

    assert set(first) == {"map.yaml", "map.pgm", "map.graph", "map.cairn"}
    assert first == second


def test_killed_component_continues_where_it_was(
    slam: ComponentHarness[Slam], tmp_path: Path
) -> None:
    robot = Driver(slam)
    robot.stand()
    robot.drive(40)
    # What a kill leaves is what the files hold while the component still has them open.
    left = tmp_path / "left"
    left.mkdir()
    for file in tmp_path.glob("map.*"):
        shutil.copy(file, left)
    slam.run_for(2.0)

    again = ComponentHarness(
        Slam, {"map_file": str(left / "map.yaml")}, beside=slam, name="again", restarts=1
    )
    robot_again = Driver(again)
    robot_again.true, robot_again.odometry = robot.true, robot.odometry
    robot_again.drive(10)

    assert last_pose(again) == pytest.approx(robot_again.true, abs=0.02)
    again.request("deactivate")
    assert len(read_graph(left / "map.graph").keyframes) >= 10


def test_kill_loses_at_most_five_seconds_of_the_map(
    slam: ComponentHarness[Slam], tmp_path: Path
) -> None:
    robot = Driver(slam)
    for speed in (0.5, -0.5):
        for _ in range(70):
            robot.drive(1, speed)
            if slam.now_ns > 102 * SECOND:
                saved_ns = read_graph(tmp_path / "map.graph").keyframes[-1].stamp_ns
                assert slam.now_ns - saved_ns <= 5 * SECOND


def test_robot_that_is_moved_is_not_located_until_it_is_recognized(
    slam: ComponentHarness[Slam],
) -> None:
    robot = Driver(slam)
    robot.drive(45)
    robot.true = (1.0, 1.0, math.pi / 2)

    for _ in range(6):
        robot.stand()

    estimates = slam.take("localization")
    assert estimates[44].located
    assert not estimates[-1].located
    assert estimates[-1].health == 0.0
    assert estimates[-1].reason == "no place of the map is recognized yet"


def test_scan_without_odometry_is_not_mapped(slam: ComponentHarness[Slam]) -> None:
    robot = Driver(slam)
    robot.stand()
    assert len(slam.take("localization")) == 1
    old = LaserScan(
        header=Header(stamp=from_ns(slam.now_ns - 90 * 10**9)),
        angle_max=0.09,
        angle_increment=0.01,
        range_max=10.0,
        ranges=np.ones(10, np.float32),
    )

    slam.publish("scan", old)

    assert slam.take("localization") == []


def test_wrong_files_are_refused_before_the_robot_moves(tmp_path: Path) -> None:
    (tmp_path / "old.graph").write_text("not a graph")

    for parameters, fault in (
        ({"map_file": str(tmp_path / "missing" / "map.yaml")}, "no such folder"),
        ({"map_file": str(tmp_path / "map.png")}, "must end in .yaml"),
        (
            {"map_file": str(tmp_path / "map.yaml"), "extend": str(tmp_path / "old.graph")},
            "old.graph: not a graph",
        ),
    ):
        with pytest.raises(CairnError, match=fault):
            ComponentHarness(Slam, parameters)


def test_graph_that_slam_writes_itself_is_not_extended(
    slam: ComponentHarness[Slam], tmp_path: Path
) -> None:
    Driver(slam).drive(20)
    slam.request("deactivate")
    graph = tmp_path / "map.graph"

    with pytest.raises(CairnError, match="extend a copy of it"):
        ComponentHarness(Slam, {"map_file": str(tmp_path / "map.yaml"), "extend": str(graph)})

    assert len(read_graph(graph).keyframes) > 3


def test_new_run_keeps_the_graph_of_the_run_before_it(
    slam: ComponentHarness[Slam], tmp_path: Path
) -> None:
    Driver(slam).drive(40)
    slam.run_for(4.0)
    left = tmp_path / "left"  # by a computer that was switched off
    left.mkdir()
    for file in tmp_path.glob("map.*"):
        shutil.copy(file, left)
    saved = len(read_graph(left / "map.graph").keyframes)

    files = {"map_file": str(left / "map.yaml")}
    ComponentHarness(Slam, files)  # is killed before its first scan
    again = ComponentHarness(Slam, files, restarts=1)
    Driver(again).stand()

    assert len(read_graph(left / "map.before.graph").keyframes) == saved > 3
    assert again.request("status")["keyframes"] == 1


def test_map_goes_on_being_saved_and_published_after_time_was_set_back(tmp_path: Path) -> None:
    slam = ComponentHarness(Slam, {"map_file": str(tmp_path / "map.yaml")}, simulated_time=True)
    robot = Driver(slam)
    robot.time_s = 100.0
    robot.drive(40)
    saved = len(read_graph(tmp_path / "map.graph").keyframes)
    slam.take("map")
    robot.time_s = 50.0

    robot.drive(60, speed=-0.25)

    assert len(read_graph(tmp_path / "map.graph").keyframes) > saved
    assert slam.take("map")


def test_pose_stays_when_time_is_set_back_after_odometry_has_restarted(tmp_path: Path) -> None:
    slam = ComponentHarness(Slam, {"map_file": str(tmp_path / "map.yaml")}, simulated_time=True)
    robot = Driver(slam)
    robot.time_s = 100.0
    robot.odometry = (4.0, -3.0, 2.0)
    robot.stand()
    robot.odometry = (0.0, 0.0, 0.0)
    robot.drive(30)
    robot.time_s = 50.0

    robot.drive(5)

    assert last_pose(slam) == pytest.approx(robot.true, abs=0.03)


def test_reactivated_component_goes_on_saving_the_map(
    slam: ComponentHarness[Slam], tmp_path: Path
) -> None:
    robot = Driver(slam)
    robot.drive(20)
    slam.request("deactivate")
    saved = len(read_graph(tmp_path / "map.graph").keyframes)
    slam.request("activate")

    robot.drive(20)
    keyframes = slam.request("save")["keyframes"]

    assert keyframes > saved
    assert len(read_graph(tmp_path / "map.graph").keyframes) == keyframes


def test_killed_component_extends_the_map_if_nothing_was_saved_yet(tmp_path: Path) -> None:
    mapper = Mapper(10.0)
    drive(mapper, 0, 30)
    write_graph(tmp_path / "old.graph", mapper, "a test")
    GraphFile.create(tmp_path / "map.graph", 10.0, "killed").close()
    files = {"map_file": str(tmp_path / "map.yaml"), "extend": str(tmp_path / "old.graph")}
    slam = ComponentHarness(Slam, files, restarts=1)

    Driver(slam).stand()

    assert slam.request("status")["keyframes"] == len(mapper.keyframes) + 1


def test_map_that_was_to_be_extended_is_saved_with_a_warning_if_nothing_joins_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mapper = Mapper(10.0)
    drive(mapper, 0, 30)
    write_graph(tmp_path / "old.graph", mapper, "a test")
    files = {"map_file": str(tmp_path / "map.yaml"), "extend": str(tmp_path / "old.graph")}
    slam = ComponentHarness(Slam, files)
    Driver(slam).stand()

    slam.request("save")

    assert "no place of the map that is extended was recognized" in caplog.text
    saved = read_graph(tmp_path / "map.graph")
    assert int(saved.in_map().sum()) == len(mapper.keyframes) == len(saved.keyframes) - 1


def test_map_of_a_covered_scanner_is_not_written(
    slam: ComponentHarness[Slam], tmp_path: Path
) -> None:
    robot = Driver(slam)
    robot.covered = True
    robot.stand()

    with pytest.raises(CairnError, match="nothing covers the scanner"):
        slam.request("save")
    slam.request("deactivate")

    assert not (tmp_path / "map.yaml").exists()
