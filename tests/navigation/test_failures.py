"""Silent inputs, restarted components and invalid maps stop the robot or fail its mission."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cairn import SENSOR, CairnError
from cairn.planar.poses import distance
from cairn.schemas.cairn_nav_msgs import MotionStatus, NavigationStatus
from cairn.schemas.sensor_msgs import LaserScan
from tests.navigation.driving import DEPLOY, ON_REQUEST, STOPS_S, LockstepRobot
from tests.sweeps import sampled

pytestmark = pytest.mark.slow

RobotFactory = Callable[..., LockstepRobot]


def test_silent_scanner_stops_the_robot_until_it_returns(
    drive: RobotFactory,
) -> None:
    robot = drive()
    robot.go(4.0, 1.4)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(4.0)

    robot.request("mobile_supervisor", "unload", name="range_scanner")

    robot.run_for(2.0)
    assert robot.stands()
    assert robot.motions[-1].state == MotionStatus.STOPPED
    assert re.fullmatch(r"no scan for 2\.\d+ s on /robot/scan", robot.statuses[-1].reason)
    robot.request("mobile_supervisor", "load", name="range_scanner")
    robot.assert_arrives((4.0, 1.4))


@pytest.mark.accuracy
def test_scanner_that_stays_silent_fails_the_mission(drive: RobotFactory) -> None:
    robot = drive()
    robot.go(7.0, 5.0)
    robot.await_state(NavigationStatus.DRIVING)
    robot.request("mobile_supervisor", "unload", name="range_scanner")

    end = robot.await_end(40.0)

    assert end.state == NavigationStatus.FAILED
    assert re.match(r"no scan for \d+\.\d+ s on /robot/scan", end.reason)
    assert robot.stands()


def invalid(scan: LaserScan, how: str) -> LaserScan:
    ranges = np.full(scan.ranges.size, math.inf if how == "hits nothing" else math.nan, np.float32)
    return replace(scan, ranges=ranges[:0] if how == "no beams" else ranges)


@pytest.mark.parametrize("how", sampled(["unknown", "no beams", "hits nothing"]))
def test_invalid_scans_stop_the_robot(drive: RobotFactory, how: str) -> None:
    scanner = "components.range_scanner.topics.scan=true_scan"
    robot = drive(scanner, "external_topics=[scan]")
    scans, invalidate = robot.read("true_scan", LaserScan), False

    def relay(seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            robot.run_for(0.05)
            for scan in scans.take():
                robot.publish("scan", invalid(scan, how) if invalidate else scan, qos=SENSOR)

    relay(1.0)
    robot.go(7.0, 5.0)
    relay(4.0)
    assert robot.states()[-1] == NavigationStatus.DRIVING
    invalidate = True
    relay(0.2)
    x, y, theta = robot.truth
    ahead = (x + 1.4 * math.cos(theta), y + 1.4 * math.sin(theta))
    robot.request("world", "furniture", name="barrier", x=ahead[0], y=ahead[1], size=[0.4, 0.4])
    relay(6.0)

    assert robot.collisions == []
    assert robot.statuses[-1].state != NavigationStatus.SUCCEEDED
    assert re.search(
        r"no valid scan( on /robot/scan)? for",
        robot.statuses[-1].reason,
    )
    invalidate = False
    before, deadline = robot.truth, robot.now + 20.0
    while distance(before, robot.truth) <= 0.5:
        assert robot.now < deadline
        relay(0.5)
    assert robot.collisions == []


@pytest.mark.parametrize(
    ("component", "missed_after_s"),
    sampled(
        [("motion_control", 0.3), ("range_scanner", 0.5), ("localizer", 1.0), ("automove", 1.5)]
    ),
)
def test_silent_component_stops_the_robot_in_time(
    drive: RobotFactory, component: str, missed_after_s: float
) -> None:
    robot = drive()
    robot.go(6.6, 1.8)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(3.0)

    robot.suspend(component)

    assert missed_after_s < robot.time_to_stand() <= missed_after_s + STOPS_S
    assert robot.collisions == []


@pytest.mark.accuracy
@pytest.mark.parametrize(
    "component", sampled(["localizer", "motion_control", "map_builder", "path_planner"])
)
def test_restarted_plugin_does_not_end_the_mission(drive: RobotFactory, component: str) -> None:
    robot = drive()
    robot.go(6.6, 1.8)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(3.0)

    robot.request("automove", "restart", name=component)

    robot.assert_arrives((6.6, 1.8))
    assert len({status.mission_id for status in robot.statuses}) == 1


@pytest.mark.parametrize("component", sampled(["base", "range_scanner", "automove"]))
def test_restarted_child_does_not_end_the_mission(drive: RobotFactory, component: str) -> None:
    robot = drive()
    robot.send([3.0, 1.2, 0.0], [6.6, 1.8, 0.0])
    robot.await_goal(1)
    robot.run_for(2.0)

    robot.request("mobile_supervisor", "restart", name=component)

    robot.assert_arrives((6.6, 1.8))
    assert len({status.mission_id for status in robot.statuses}) == 1
    assert all(s.goal > 0 for s in robot.statuses if s.elapsed > 30.0)


STATE_FILE = "components.mobile_supervisor.parameters.state_file=${report}/mission.json"


@pytest.mark.accuracy
def test_restarted_supervisor_continues_its_mission(drive: RobotFactory) -> None:
    robot = drive(STATE_FILE)
    robot.send([3.0, 1.2, 0.0], [6.6, 1.8, 0.0])
    robot.await_goal(1)
    missions = {status.mission_id for status in robot.statuses}

    robot.request("root", "restart", name="mobile_supervisor")

    robot.assert_arrives((6.6, 1.8))
    assert {status.mission_id for status in robot.statuses} == missions
    assert len(missions) == 1


def test_restarted_supervisor_without_a_mission_leaves_the_robot_standing(
    drive: RobotFactory, tmp_path: Path
) -> None:
    robot = drive(STATE_FILE)
    robot.go(6.6, 1.8)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(3.0)
    (tmp_path / "mission.json").unlink()

    robot.request("root", "restart", name="mobile_supervisor")

    robot.run_for(2.0)
    assert robot.stands()


def no_map(folder: Path) -> Path:
    return folder / "nowhere.yaml"


def map_of_another_size(folder: Path) -> Path:
    text = (DEPLOY / "maps" / "room.yaml").read_text(encoding="utf-8")
    file = folder / "small.yaml"
    text = re.sub("image: .*", "image: small.pgm", text) + "width: 201\nheight: 161\n"
    file.write_text(text, encoding="utf-8")
    Image.new("L", (7, 5), 254).save(folder / "small.pgm")
    return file


def no_picture(folder: Path) -> Path:
    file = map_of_another_size(folder)
    (folder / "small.pgm").write_bytes(b"P5 not a picture")
    return file


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (no_map, "nowhere.yaml"),
        (map_of_another_size, "small.pgm"),
        (no_picture, "small.pgm"),
    ],
)
def test_invalid_map_fails_the_deployment_at_once(
    drive: RobotFactory, tmp_path: Path, make: Callable[[Path], Path], cause: str
) -> None:
    robot = drive(f"settings.map={make(tmp_path)}")

    with pytest.raises(CairnError, match=cause):
        robot.run_for(1.0)

    assert robot.end is not None
    assert not robot.end.normal
    assert robot.end.reason.count(cause) == 1
    assert robot.now == 0.0


def test_invalid_map_fails_the_mission_at_once(drive: RobotFactory, tmp_path: Path) -> None:
    robot = drive(f"settings.map={no_map(tmp_path)}", ON_REQUEST)
    robot.go(3.0, 1.2)

    end = robot.await_end(5.0)

    assert end.state == NavigationStatus.FAILED
    assert end.reason.startswith("not all plugins can be loaded: map_builder: ")
    assert "nowhere.yaml" in end.reason
