"""AutoMove on a bus in virtual time: orders in; plugins loaded, wants and progress out."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from cairn import LATCHED
from cairn.deployment.load import load_deployment
from cairn.planar.messages import packed_poses, planar_pose, pose_message
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigateGoal,
    NavigationStatus,
    Plan,
)
from cairn.schemas.geometry_msgs import PoseWithCovariance
from tests.navigation.deployed import Deployed, taken

PLUGINS = """
cairn: 1
robot: robot
components:
  automove:
    plugin: automove
    children:
      beacon: {plugin: test_beacon, load: on_request}
      talker: {plugin: test_talker, load: on_request, parameters: {words: 1000000}}
"""
BROKEN = """
cairn: 1
robot: robot
components:
  automove:
    plugin: automove
    children:
      base: {plugin: test_faulty, load: on_request, parameters: {fault: raise, where: on_activate}}
"""
DeployedOf = Callable[..., Deployed]


@pytest.fixture
def deployed(tmp_path: Path) -> Iterator[DeployedOf]:
    made: list[Deployed] = []

    def make(text: str, *sets: str) -> Deployed:
        file = tmp_path / "deployment.yaml"
        file.write_text(text, encoding="utf-8")
        made.append(Deployed(load_deployment(file, sets=sets)))
        return made[-1]

    yield make
    for one in made:
        one.end()


def order(number: int, *goals: tuple[float, float, float], first: int = 0) -> NavigateGoal:
    rows = np.array(goals, np.float64).reshape(-1, 3)
    return NavigateGoal(mission_id=number, first=first, goals=packed_poses(rows))


def test_mission_loads_the_plugins_and_publishes_each(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses = robot.read("navigation_status", NavigationStatus)
    robot.wait(1.0)
    assert taken(statuses) == []

    robot.publish("navigate_goal", order(7, (1.0, 2.0, 0.5)), LATCHED)
    reported = taken(statuses)
    assert [(s.mission_id, s.state, s.reason) for s in reported] == [
        (7, NavigationStatus.LOADING, "beacon"),
        (7, NavigationStatus.LOADING, "talker"),
        (7, NavigationStatus.LOCALIZING, ""),
        (7, NavigationStatus.LOCALIZING, "no estimate from the localizer yet"),
    ]


def test_plugin_that_cannot_be_loaded_fails_the_mission(deployed: DeployedOf) -> None:
    robot = deployed(BROKEN)
    statuses = robot.read("navigation_status", NavigationStatus)
    for number in (1, 2):
        robot.publish("navigate_goal", order(number, (1.0, 2.0, 0.5)), LATCHED)
        last = taken(statuses)[-1]
        assert (last.mission_id, last.state) == (number, NavigationStatus.FAILED)
        assert last.reason == (
            "not all plugins can be loaded: base: activate failed: ValueError: broken on purpose"
        )
    assert robot.run.end is None


def test_command_is_published_on_change_and_twice_a_second(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    nav_commands, statuses = (
        robot.read("nav_command", NavCommand),
        robot.read("navigation_status", NavigationStatus),
    )
    robot.publish("localization", LocalizationEstimate(located=True, health=0.9))
    robot.publish("navigate_goal", order(1, (1.0, 2.0, 0.5), (3.0, 4.0, 0.0), first=1), LATCHED)
    robot.wait(0.1)
    wanted = taken(nav_commands)[-1]
    assert wanted.behavior == NavCommand.FOLLOW
    assert planar_pose(wanted.goal) == pytest.approx((3.0, 4.0, 0.0))
    assert (wanted.position_tolerance, wanted.heading_tolerance) == (0.1, 0.1)

    robot.publish("plan", Plan(goal_id=wanted.goal_id), LATCHED)
    robot.publish(
        "motion_status",
        MotionStatus(goal_id=wanted.goal_id, state=MotionStatus.MOVING, distance_left=2.0),
    )
    robot.wait(1.0)
    assert 2 <= len(taken(nav_commands)) <= 4
    reported = taken(statuses)[-1]
    assert (reported.state, reported.goal, reported.goals) == (NavigationStatus.DRIVING, 1, 2)
    assert (reported.distance_left, reported.time_left) == (2.0, 5.0)
    assert reported.elapsed == pytest.approx(1.1, abs=0.5)

    robot.publish("motion_status", MotionStatus(goal_id=wanted.goal_id, state=MotionStatus.DONE))
    assert taken(statuses)[-1].state == NavigationStatus.SUCCEEDED
    assert taken(nav_commands)[-1].behavior == NavCommand.STAND


def test_giving_way_commands_the_planner(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    nav_commands = robot.read("nav_command", NavCommand)
    for x in range(11):
        pose = PoseWithCovariance(pose=pose_message((0.2 * x, 0.0, 0.0)))
        robot.publish("localization", LocalizationEstimate(located=True, pose=pose, health=0.9))
    robot.publish("navigate_goal", order(1, (4.0, 0.0, 0.5)), LATCHED)

    goals = []
    for _ in range(120):
        robot.publish("localization", LocalizationEstimate(located=True, pose=pose, health=0.9))
        for wanted in taken(nav_commands):
            if wanted.behavior == NavCommand.FOLLOW:
                goals.append(planar_pose(wanted.goal)[0])
                robot.publish(
                    "plan", Plan(goal_id=wanted.goal_id, outcome=Plan.GOAL_BLOCKED), LATCHED
                )
        robot.wait(0.1)

    assert goals[0] == pytest.approx(4.0)
    assert pytest.approx(0.6) in goals


@pytest.mark.parametrize(
    ("sets", "state"),
    [
        ((), NavigationStatus.SUCCEEDED),
        (("components.automove.parameters.sure_health=0.8",), NavigationStatus.RECOVERING),
    ],
)
def test_sure_health_is_configurable(
    deployed: DeployedOf, sets: tuple[str, ...], state: int
) -> None:
    robot = deployed(PLUGINS, *sets)
    statuses, nav_commands = (
        robot.read("navigation_status", NavigationStatus),
        robot.read("nav_command", NavCommand),
    )
    robot.publish("localization", LocalizationEstimate(located=True, health=0.7))
    robot.publish("navigate_goal", order(1, (1.0, 2.0, 0.5)), LATCHED)
    robot.wait(0.1)
    goal_id = taken(nav_commands)[-1].goal_id
    robot.publish("plan", Plan(goal_id=goal_id), LATCHED)
    robot.wait(0.2)

    robot.publish("motion_status", MotionStatus(goal_id=goal_id, state=MotionStatus.DONE))

    assert taken(statuses)[-1].state == state


def test_changing_numbers_in_a_reason_are_not_published_at_once(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses, nav_commands = (
        robot.read("navigation_status", NavigationStatus),
        robot.read("nav_command", NavCommand),
    )
    robot.publish("localization", LocalizationEstimate(located=True, health=0.9))
    robot.publish("navigate_goal", order(1, (1.0, 2.0, 0.5)), LATCHED)
    robot.wait(0.1)
    goal_id = taken(nav_commands)[-1].goal_id
    robot.publish("plan", Plan(goal_id=goal_id), LATCHED)
    for tenths in range(6, 26):
        reason = f"no scan for {tenths / 10:.1f} s on /robot/scan"
        robot.publish(
            "motion_status",
            MotionStatus(goal_id=goal_id, state=MotionStatus.STOPPED, reason=reason),
        )
        robot.wait(0.1)
    assert len(taken(statuses)) < 12


def test_new_mission_preempts_and_empty_mission_cancels(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses, nav_commands = (
        robot.read("navigation_status", NavigationStatus),
        robot.read("nav_command", NavCommand),
    )
    robot.publish("navigate_goal", order(1, (1.0, 2.0, 0.5)), LATCHED)
    robot.publish("navigate_goal", order(2, (3.0, 4.0, 0.5)), LATCHED)
    robot.publish("navigate_goal", order(2, (3.0, 4.0, 0.5)), LATCHED)  # repeated: nothing new
    robot.wait(0.2)
    assert taken(statuses)[-1].mission_id == 2
    goal_ids = len({nav_command.goal_id for nav_command in taken(nav_commands)})

    robot.publish("navigate_goal", order(1), LATCHED)  # of an order that is over: no matter
    robot.wait(0.2)
    assert taken(statuses) == []
    robot.publish("navigate_goal", order(2), LATCHED)

    last = taken(statuses)[-1]
    assert (last.mission_id, last.state) == (2, NavigationStatus.CANCELED)
    stand = taken(nav_commands)[-1]
    assert stand.behavior == NavCommand.STAND
    assert goal_ids == 2


def test_finished_mission_is_ignored(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses = robot.read("navigation_status", NavigationStatus)
    robot.publish("navigate_goal", order(9), LATCHED)
    robot.publish("navigate_goal", order(10, (1.0, 1.0, 0.0), first=1), LATCHED)
    robot.wait(1.0)
    assert taken(statuses) == []
