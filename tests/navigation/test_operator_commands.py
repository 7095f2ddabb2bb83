"""`cairn stop`, `cairn zone` and `cairn go PLACE` as an operator uses them, in real processes.

And commands to the base that are not the operator's.
"""

import json
import math
import os
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from cairn.client import Teleoperation, connect
from cairn.planar.poses import distance
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.testing.robot import RunningDeployment
from tests.commands import Answer, cairn
from tests.navigation.processes import ObservedRobot, robot_in
from tests.wording import assert_words

pytestmark = [pytest.mark.xdist_group("robots in real time"), pytest.mark.processes]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObservedRobot]:
    """A robot that the tests share, in their sequence."""
    renamed = "components.velocity_gate.topics.teleoperation=joystick"
    with robot_in(tmp_path_factory.mktemp("robot"), renamed) as robot:
        yield robot


def zone(robot: ObservedRobot, *words: str) -> str:
    answer = cairn("zone", *words, connect=robot.run.endpoint)
    assert (answer.code, answer.err) == (0, ""), answer
    return answer.out


def test_zone_that_appears_is_driven_around_and_the_place_is_reached(robot: ObservedRobot) -> None:
    zone(robot, "add", "kitchen", "place", "6.6,1.4", "--heading", "90deg")
    going = robot.go("kitchen")
    going.await_output("driving")
    out = zone(robot, "add", "wet floor", "keepout", "3.4,0.1", "4.2,0.1", "4.2,1.9", "3.4,1.9")
    assert out == "the map has 2 zones (version 3)\n"

    assert going.await_end() == 0

    assert_words(going.lines[0], "go to", "kitchen", "Ctrl-C")
    assert math.dist(robot.pose[:2], (6.6, 1.4)) < 0.25
    inside = [pose for pose in robot.path() if 3.4 < pose[0] < 4.2 and pose[1] < 1.9]
    assert inside == []
    assert robot.collisions == []


def test_killed_map_builder_has_the_zones_again(robot: ObservedRobot) -> None:
    lines = len(robot.run.lines)
    robot.kill("map_builder")
    robot.run.await_line("child active: map_builder|restarted child map_builder", after=lines)

    rows = json.loads(zone(robot, "list", "--json"))

    assert [(row["name"], row["kind"]) for row in rows] == [
        ("kitchen", "place"),
        ("wet floor", "keepout"),
    ]


def test_goal_in_the_zone_and_unknown_place_are_refused_with_the_reason(
    robot: ObservedRobot,
) -> None:
    going = robot.go("3.8", "1.0")
    assert going.await_end() == 1
    assert_words(going.lines[-1], "keepout zone wet floor", "nearest reachable position")

    answer = cairn("go", "cellar", connect=robot.run.endpoint)
    assert answer.code == 1
    assert "cellar: no such place on the map; the places are: kitchen" in answer.err


def test_zones_are_checked_and_loaded_from_a_file(robot: ObservedRobot, tmp_path: Path) -> None:
    file = tmp_path / "map.zones.geojson"
    place = {
        "type": "Feature",
        "properties": {"zone": "place", "name": "dock"},
        "geometry": {"type": "Point", "coordinates": [-1.0, 1.0]},
    }
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [place, place]}))
    checked = cairn("map", "zones", str(file))
    assert checked.code == 1
    assert_words(checked.err, str(file), "dock", "names must differ")

    file.write_text(json.dumps({"type": "FeatureCollection", "features": [place]}))
    assert_words(cairn("map", "zones", str(file)).out, "1 zone", "dock", "place")
    zone(robot, "load", str(file))
    assert_words(zone(robot, "list"), "dock", "place")
    assert "kitchen" not in zone(robot, "list")
    zone(robot, "remove", "dock")
    assert_words(zone(robot, "list"), "the map has no zones")


def test_invalid_zone_is_refused_before_it_is_sent() -> None:
    answer = cairn("zone", "add", "a", "keepout", "0,0", "1,1", "1,0", "0,1")
    assert answer.code == 1
    assert_words(answer.err, "cross or touch")
    answer = cairn("zone", "add", "a", "slow", "0,0", "1,0", "-1,1")
    assert answer.code == 1
    assert_words(answer.err, "speed")


def test_forged_commands_do_not_move_the_robot_and_their_publisher_is_named(
    robot: ObservedRobot,
) -> None:
    ahead = Twist(linear=Vector3(x=0.4))
    with closing(RunningDeployment(robot.run)) as intruder:
        begin = robot.pose
        with intruder.publishing("cmd_vel", ahead), intruder.publishing("navigator_cmd_vel", ahead):
            for component in ("base", "velocity_gate"):  # 2 s of commands at 20 Hz
                intruder.await_status(
                    component,
                    lambda status: any(port.refused >= 40 for port in status.ports),
                    "refusing 40 commands",
                )
        assert distance(begin, robot.pose) < 0.001
        for component in ("base", "velocity_gate"):
            assert "refused message on" in robot.run.log_of(component)
            assert "/conformance" in robot.run.log_of(component)


def test_stop_command_works_while_the_supervisor_is_stopped(robot: ObservedRobot) -> None:
    endpoint = robot.run.endpoint
    with connect(endpoint) as client, client.teleoperation("anna") as drive:
        assert isinstance(drive, Teleoperation)
        begin = robot.pose  # at the start, or at the kitchen, which has room ahead as well
        drive(0.3, 0.0, seconds=2.0)
        assert distance(begin, robot.pose) > 0.2
    stopped = _stop_while_suspended(robot, "mobile_supervisor")
    assert stopped.code == 0, stopped.err
    assert "emergency stop" in stopped.out

    failed = _stop_while_suspended(robot, "velocity_gate")
    assert failed.code == 1
    assert "press the robot's own emergency stop" in failed.err
    assert cairn("stop", "--release", connect=endpoint).code == 0


def _stop_while_suspended(robot: ObservedRobot, component: str) -> Answer:
    """Run `cairn stop` while a component's process is suspended (SIGSTOP)."""
    process = robot.run.pid_of(component)
    os.kill(process, signal.SIGSTOP)
    try:
        return cairn("stop", connect=robot.run.endpoint)
    finally:
        os.kill(process, signal.SIGCONT)
