"""The robot explores and maps an unknown world: in lockstep, and in real processes with kills."""

from __future__ import annotations

import math
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.components.simulation.world_file import read_world
from cairn.components.slam.graph_file import read_graph
from cairn.planar.map_file import read_map
from cairn.planar.poses import apart
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.cairn_nav_msgs import ExplorationStatus
from cairn.testing.launching import CAIRN, LIMIT_S, Run, launching, new_endpoint
from cairn.testing.lockstep import DeploymentHarness
from cairn_lab.benchmarks.explore import explore
from cairn_lab.evaluation.map_comparison import WALL_M, compare_with_world
from tests.commands import cairn
from tests.navigation.driving import DEPLOY, send_poses
from tests.navigation.processes import ObservedRobot
from tests.wording import assert_words

MAPPING = DEPLOY / "mapping.yaml"
ROOM = DEPLOY / "worlds" / "room.yaml"


@pytest.mark.slow
def test_room_is_explored_completely_without_a_collision(tmp_path: Path) -> None:
    found = explore("room", tmp_path)

    assert found.status.state == ExplorationStatus.FINISHED
    assert found.status.given_up == 0
    assert found.map.known > 0.99
    assert found.map.within(WALL_M) > 0.95
    assert found.collisions == 0
    assert found.driven_m < 25.0


@pytest.mark.slow
def test_goal_of_an_operator_ends_the_exploration_and_is_reached(tmp_path: Path) -> None:
    sets = [f"settings.report={tmp_path}", "settings.explore=on_activation"]
    with DeploymentHarness(MAPPING, sets=sets) as robot:
        statuses = robot.read("exploration_status", ExplorationStatus).messages
        robot.run_until(lambda: bool(statuses) and not math.isnan(statuses[-1].goal_x))
        robot.run_for(5.0)
        sent = send_poses(robot, [0.5, 0.0, 0.0])

        robot.run_until(lambda: statuses[-1].state == ExplorationStatus.STOPPED, 1.0)
        assert statuses[-1].reason.startswith("preempted by mission ")

        robot.run_until(lambda: sent.has_ended, 60.0)
        assert sent.status == GoalStatus.STATUS_SUCCEEDED
        assert statuses[-1].state == ExplorationStatus.STOPPED


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObservedRobot]:
    """A robot that both tests share, in their sequence: one goes on where the other ended."""
    folder = tmp_path_factory.mktemp("robot")
    with launching(folder) as launch:
        endpoint = new_endpoint()
        arguments = [str(MAPPING), "--set", f"bus.socket={endpoint}"]
        run = Run(arguments, folder / "report", endpoint, {}, None)
        launch.runs.append(run)
        run.await_line("child active: mobile_supervisor")
        bus = ZenohBus(open_peer([endpoint]))
        try:
            yield ObservedRobot(run, bus)
        finally:
            bus.close()


@pytest.mark.accuracy
@pytest.mark.processes
@pytest.mark.xdist_group("robots in real time")
def test_ctrl_c_ends_the_exploration_and_the_map_so_far_is_saved(
    robot: ObservedRobot, tmp_path: Path
) -> None:
    connect, out = robot.run.endpoint, tmp_path / "maps" / "room"
    exploring = subprocess.Popen(
        [CAIRN, "explore", "--connect", connect], stdout=subprocess.PIPE, text=True
    )
    try:
        robot.await_moved(0.5)
        exploring.send_signal(signal.SIGINT)
        output, _ = exploring.communicate(timeout=LIMIT_S)
    finally:
        exploring.kill()
    assert exploring.returncode == 130
    assert output.splitlines()[-1] == "exploration ended: the robot stops"
    assert " 0 m² are free" not in output  # nothing is printed before the explorer has a map
    robot.await_stand()

    saved = cairn("map", "save", str(out), "--json", connect=connect)
    assert saved.code == 0, saved.err
    assert [Path(file).name for file in saved.json["files"]] == [
        "room.yaml",
        "room.pgm",
        "room.graph",
    ]
    assert len(read_graph(out.with_suffix(".graph")).keyframes) == saved.json["keyframes"]
    size_m = saved.json["width_m"], saved.json["height_m"]
    assert read_map(out.with_suffix(".yaml")).size_m == size_m
    for command in (("map", "save"), ("explore", "--save")):
        again = cairn(*command, str(out), connect=connect)
        assert again.code == 1
        assert_words(again.err, "room.yaml exists already", "--force")
    assert cairn("map", "save", str(out), "--force", connect=connect).code == 0


@pytest.mark.accuracy
@pytest.mark.processes
@pytest.mark.xdist_group("robots in real time")
def test_exploration_survives_kills_of_slam_explorer_and_automove(
    robot: ObservedRobot, tmp_path: Path
) -> None:
    run, graph, out = robot.run, robot.run.report / "map.graph", tmp_path / "maps" / "room"
    exploring = subprocess.Popen(
        [CAIRN, "explore", "--save", str(out), "--connect", run.endpoint],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        line = 0
        for component in ("slam", "explorer", "automove"):
            robot.await_moved(1.0)
            saved = len(read_graph(graph).keyframes)
            robot.kill(component)
            assert len(read_graph(graph).keyframes) >= saved > 0
            line = run.await_line(f"restarting child {component}: killed by SIGKILL", after=line)
            line = run.await_line(f"child active: {component}", after=line)
        output, _ = exploring.communicate(timeout=4 * LIMIT_S)
    finally:
        exploring.kill()

    assert exploring.returncode == 0, output
    assert_words(output, "nothing that the robot can reach is unknown", f"{out}.yaml")
    start = read_world(ROOM).robot.pose
    compared = compare_with_world(read_map(tmp_path / "maps" / "room.yaml"), ROOM, start, 0.22)
    assert compared.known > 0.99
    assert compared.within(WALL_M) > 0.95
    assert not apart(compared.pose, start, 0.05, 0.02)  # no restart has moved the map's frame
    assert robot.collisions == []


def test_exploration_without_an_end_has_nothing_to_save(tmp_path: Path) -> None:
    for option in ("--no-wait", "--stop"):
        answer = cairn("explore", option, "--save", str(tmp_path / "map"))
        assert answer.code == 1
        assert_words(answer.err, "--save", option)
