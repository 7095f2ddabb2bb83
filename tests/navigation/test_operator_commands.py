"""`cairn go`, `cairn zone` and `cairn stop` as an operator uses them, on one robot.

And commands to the base that are not the operator's.
"""

import json
import math
import os
import pty
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from cairn.client import Teleoperation, connect
from cairn.planar.poses import distance
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.testing.launching import CAIRN, LIMIT_S
from cairn.testing.robot import RunningDeployment
from tests.cairn.bus.network import eventually
from tests.commands import Answer, await_answer, cairn
from tests.navigation.driving import ON_REQUEST
from tests.navigation.processes import ObservedRobot, robot_in
from tests.sweeps import sampled
from tests.wording import assert_words

pytestmark = [pytest.mark.xdist_group("robots in real time"), pytest.mark.processes]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObservedRobot]:
    """A robot that all tests share, in their sequence: the first one needs it without a goal."""
    sets = (
        "components.mobile_supervisor.hang_timeout_s=2",
        # A localizer that was killed is back in time, also on a busy computer.
        "components.mobile_supervisor.children.automove.parameters.stopped=60",
        "components.velocity_gate.topics.teleoperation=joystick",
        ON_REQUEST,
    )
    with robot_in(tmp_path_factory.mktemp("robot"), *sets) as robot:
        yield robot


def zone(robot: ObservedRobot, *words: str) -> str:
    answer = cairn("zone", *words, connect=robot.run.endpoint)
    assert (answer.code, answer.err) == (0, ""), answer
    return answer.out


def far_goals(robot: ObservedRobot) -> list[str]:
    """Return goals on the other side of the room and back, twice: no test ends so late."""
    goals = ["6.6,1.8", "1.4,1.2"]
    return 2 * (goals if robot.pose[0] < 4.0 else goals[::-1])


def test_locate_is_rejected_without_a_localizer(robot: ObservedRobot) -> None:
    answer = cairn("locate", "1", "1", connect=robot.run.endpoint)

    assert answer.code == 1
    assert answer.err.startswith(
        "cairn: nothing subscribes to initialpose: no localizer runs; `cairn load localizer`"
    )


def test_go_prints_each_step_and_exits_with_0(robot: ObservedRobot) -> None:
    going = robot.go("2.0", "1.2", "10deg")

    assert going.await_end() == 0

    # On a busy computer a note may come first.
    first = next(number for number, line in enumerate(going.lines) if "go to" in line)
    printed = [re.sub(r"\d+(\.\d+)?", "N", line).strip() for line in going.lines[first:]]
    assert_words(printed[0], "go to", "(N, N, N deg)", "Ctrl-C")
    assert printed[1:5] == [
        "N s  loading: map_builder",
        "N s  loading: localizer",
        "N s  loading: path_planner",
        "N s  loading: motion_control",
    ]
    assert "N s  planning" in printed
    assert "N s  driving: N m left, about N s" in printed
    assert re.search(r"s  arrived at \(2.00, 1.20\)$", going.lines[-1].strip())


def test_locate_sets_the_pose(robot: ObservedRobot) -> None:
    assert robot.go("2.0", "1.2").await_end() == 0
    x, y, theta = robot.pose
    lines = len(robot.run.lines)

    answer = cairn("locate", str(x), str(y), str(theta), connect=robot.run.endpoint)

    assert (answer.code, answer.err) == (0, "")
    assert answer.out.startswith("published on /robot/initialpose; ")
    robot.run.await_line(
        re.escape(f"pose set by the operator: ({x:.2f} m, {y:.2f} m, "), after=lines
    )


def test_goal_outside_the_map_exits_with_1_and_the_reason(robot: ObservedRobot) -> None:
    going = robot.go("-3.5", "-2")

    assert going.await_end() == 1

    assert re.match(
        r"cairn: the goal failed after \d+\.\d s: no path: the goal \(-3.50, -2.00\) is outside "
        r"the map; the nearest reachable position, \(",
        going.lines[-1],
    ), going


def test_json_output_is_the_result_alone(robot: ObservedRobot) -> None:
    answer = cairn("go", "2.4", "1.2", "--json", connect=robot.run.endpoint)

    assert (answer.code, answer.err) == (0, "")
    assert answer.json["state"] == "succeeded"
    assert answer.json["reason"] == "arrived at (2.40, 1.20)"
    assert answer.json["elapsed_s"] > 0


def test_named_place_is_reached_while_a_zone_is_added(robot: ObservedRobot) -> None:
    zone(robot, "add", "kitchen", "place", "3.0,1.4", "--heading", "90deg")
    going = robot.go("kitchen")
    going.await_output("driving")
    out = zone(robot, "add", "wet floor", "keepout", "3.4,0.1", "4.2,0.1", "4.2,1.9", "3.4,1.9")
    assert out == "the map has 2 zones (version 3)\n"

    assert going.await_end() == 0

    begin = next(line for line in going.lines if "go to" in line)
    assert_words(begin, "go to", "kitchen", "Ctrl-C")
    assert math.dist(robot.pose[:2], (3.0, 1.4)) < 0.25
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


@pytest.mark.accuracy
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
        begin = robot.pose  # at the kitchen, which has room ahead

        def has_moved() -> bool:
            drive(0.3, 0.0, seconds=0.2)  # on a busy computer commands are late, and it rests
            return distance(begin, robot.pose) > 0.05

        assert eventually(has_moved)
    stopped = await_answer(  # until the gate confirms within its second
        lambda: _stop_while_suspended(robot, "mobile_supervisor"), lambda answer: answer.code == 0
    )
    assert "emergency stop" in stopped.out

    failed = _stop_while_suspended(robot, "velocity_gate")
    assert failed.code == 1
    assert "press the robot's own emergency stop" in failed.err
    assert eventually(lambda: cairn("stop", "--release", connect=endpoint).code == 0)


def _stop_while_suspended(robot: ObservedRobot, component: str) -> Answer:
    """Run `cairn stop` while a component's process is suspended (SIGSTOP)."""
    process = robot.run.pid_of(component)
    os.kill(process, signal.SIGSTOP)
    try:
        return cairn("stop", connect=robot.run.endpoint)
    finally:
        with suppress(ProcessLookupError):  # of a supervisor that was restarted meanwhile
            os.kill(process, signal.SIGCONT)


@pytest.mark.parametrize(
    ("number", "code"), sampled([(signal.SIGINT, 130), (signal.SIGTERM, 128 + signal.SIGTERM)])
)
def test_signal_cancels_the_mission_of_its_command(
    robot: ObservedRobot, number: signal.Signals, code: int
) -> None:
    going = robot.go(*far_goals(robot))
    going.await_output("driving")
    robot.await_moved(0.3)

    going.process.send_signal(number)

    robot.await_stand()
    assert going.await_end() == code
    assert going.lines[-1] == "canceled: the robot stops\n"
    answer = cairn("go", "--cancel", connect=robot.run.endpoint)
    assert answer.code == 1
    assert_words(answer.err, "cairn", "mobile_supervisor", "no goal")


@pytest.mark.accuracy
def test_closed_terminal_cancels_its_mission(robot: ObservedRobot) -> None:
    goals = far_goals(robot)
    child, terminal = pty.fork()
    if child == 0:
        os.execv(CAIRN, [CAIRN, "go", *goals, "--connect", robot.run.endpoint])
    printed = b""
    while b"driving" not in printed:
        printed += os.read(terminal, 4096)
    robot.await_moved(0.3)

    os.close(terminal)

    robot.await_stand()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 128 + signal.SIGHUP


def test_closed_output_cancels_the_mission(robot: ObservedRobot) -> None:
    lines = len(robot.run.lines)
    going = subprocess.Popen(
        [CAIRN, "go", *far_goals(robot), "--connect", robot.run.endpoint],
        stdout=subprocess.PIPE,
        text=True,
    )
    with going:
        assert going.stdout is not None
        assert "go to (" in going.stdout.readline()
        going.stdout.close()

        robot.run.await_line("canceled: on request", after=lines)
        assert going.wait(LIMIT_S) == 1


@pytest.mark.parametrize(("goal", "why"), [("nan", "must be finite"), ("2e5", "at most 100000")])
@pytest.mark.parametrize("how", ["--wait", "--no-wait"])
def test_json_output_has_the_reason_of_a_rejected_goal(
    robot: ObservedRobot, goal: str, why: str, how: str
) -> None:
    answer = cairn("go", goal, "1", "--json", how, connect=robot.run.endpoint)

    assert answer.code == 1
    assert answer.json["state"] == "refused"
    assert why in answer.json["reason"]
    assert answer.err == f"cairn: {answer.json['reason']}\n"


@pytest.mark.accuracy
def test_mission_of_a_hanging_supervisor_is_canceled(robot: ObservedRobot) -> None:
    going = robot.go(*far_goals(robot))
    going.await_output("driving")
    os.kill(robot.run.pid_of("mobile_supervisor"), signal.SIGSTOP)

    answer = cairn("go", "--cancel", connect=robot.run.endpoint)

    assert answer.code == 0
    assert re.fullmatch(r"goal [0-9a-f]{32} is canceled\n", answer.out)
    assert_words(answer.err, "mobile_supervisor does not answer", "restarted", "30 s")
    robot.await_stand()
    assert going.await_end() == 1
    assert "canceled after" in going.lines[-1]


def test_preempted_client_is_informed_and_cancels_nothing(robot: ObservedRobot) -> None:
    first = robot.go(*far_goals(robot))
    first.await_output("driving")
    other = ["4.0,5.0", *far_goals(robot)]
    answer = cairn("go", *other, "--no-wait", "--json", connect=robot.run.endpoint)
    goal = answer.json["goal_id"]

    assert first.await_end() == 1

    assert_words(first.lines[-1], "the goal failed", "preempted by mission")
    canceled = cairn("go", "--cancel", connect=robot.run.endpoint)
    assert (canceled.code, canceled.out) == (0, f"goal {goal} is canceled\n")


@pytest.mark.accuracy
def test_mission_lost_by_its_supervisor_is_reported(robot: ObservedRobot) -> None:
    going = robot.go(*far_goals(robot))
    going.await_output("driving")
    supervisor = robot.run.pid_of("mobile_supervisor")
    os.kill(supervisor, signal.SIGSTOP)  # it would save its mission again
    (Path(robot.run.report) / "mission.json").unlink()

    os.kill(supervisor, signal.SIGKILL)

    assert going.await_end() == 1
    assert_words(going.lines[-1], "lost", "supervisor was restarted")


def test_killed_processes_do_not_end_the_mission(robot: ObservedRobot) -> None:
    going = robot.go(*far_goals(robot))
    going.await_output("driving")
    robot.await_moved(0.2)
    lines = len(robot.run.lines)

    for component in ("localizer", "motion_control"):
        robot.kill(component)

    for component in ("localizer", "motion_control"):
        robot.run.await_line(f"child failed: {component}: killed by SIGKILL", after=lines)
    robot.await_moved(0.3)
    assert going.process.poll() is None, f"{going}; {robot.run}"
    assert robot.collisions == []
    assert cairn("go", "--cancel", connect=robot.run.endpoint).code == 0
    assert going.await_end() == 1


def test_end_of_the_deployment_is_reported(robot: ObservedRobot) -> None:
    going = robot.go(*far_goals(robot))
    going.await_output("go to ")

    robot.run.stop()

    assert going.await_end() == 1
    assert re.fullmatch(
        r"cairn: the deployment has ended, and with it the goal\n",
        going.lines[-1],
    ), going
