"""AutoMove on a bus in virtual time: orders in; plugins loaded, wants and progress out."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from cairn import LATCHED
from cairn.deployment.load import load_deployment
from cairn.planar.messages import packed_poses, planar_pose, pose_message
from cairn.schemas.cairn_nav_msgs import (
    LocalizationHealth,
    MotionStatus,
    Movement,
    MoveOrder,
    MoveStatus,
    Plan,
)
from cairn.schemas.geometry_msgs import PoseWithCovariance, PoseWithCovarianceStamped
from tests.navigation.deployed import Deployed, taken

PLUGINS = """
cairn: 1
robot: robot
components:
  automove:
    plugin: automove
    children:
      beacon: {plugin: test_beacon, load: on_order}
      talker: {plugin: test_talker, load: on_order, parameters: {words: 1000000}}
"""
BROKEN = """
cairn: 1
robot: robot
components:
  automove:
    plugin: automove
    children:
      base: {plugin: test_faulty, load: on_order, parameters: {fault: raise, where: on_activate}}
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


def order(number: int, *goals: tuple[float, float, float], first: int = 0) -> MoveOrder:
    rows = np.array(goals, np.float64).reshape(-1, 3)
    return MoveOrder(order_id=number, first=first, goals=packed_poses(rows))


def test_an_order_loads_the_plugins_in_turn_and_tells_which(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses = robot.read("move_status", MoveStatus)
    robot.wait(1.0)
    assert taken(statuses) == []

    robot.publish("order", order(7, (1.0, 2.0, 0.5)), LATCHED)
    told = taken(statuses)
    assert [(s.order_id, s.state, s.reason) for s in told] == [
        (7, MoveStatus.LOADING, "beacon"),
        (7, MoveStatus.LOADING, "talker"),
        (7, MoveStatus.LOCALIZING, ""),
        (7, MoveStatus.LOCALIZING, "the localizer has told nothing yet"),
    ]


def test_plugins_that_cannot_be_loaded_end_the_order_with_the_cause(deployed: DeployedOf) -> None:
    robot = deployed(BROKEN)
    statuses = robot.read("move_status", MoveStatus)
    for number in (1, 2):
        robot.publish("order", order(number, (1.0, 2.0, 0.5)), LATCHED)
        last = taken(statuses)[-1]
        assert (last.order_id, last.state) == (number, MoveStatus.FAILED)
        assert last.reason == (
            "not all plugins can be loaded: base: activate failed: ValueError: broken on purpose"
        )
    assert robot.run.end is None


def test_what_is_wanted_is_told_on_change_and_twice_a_second(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    movements, statuses = robot.read("movement", Movement), robot.read("move_status", MoveStatus)
    robot.publish("localization_health", LocalizationHealth(located=True, health=0.9))
    robot.publish("order", order(1, (1.0, 2.0, 0.5), (3.0, 4.0, 0.0), first=1), LATCHED)
    robot.wait(0.1)
    wanted = taken(movements)[-1]
    assert wanted.behavior == Movement.FOLLOW
    assert planar_pose(wanted.goal) == pytest.approx((3.0, 4.0, 0.0))
    assert (wanted.position_tolerance, wanted.heading_tolerance) == (0.1, 0.1)

    robot.publish("plan", Plan(leg=wanted.leg), LATCHED)
    robot.publish(
        "motion_status",
        MotionStatus(leg=wanted.leg, state=MotionStatus.MOVING, distance_left=2.0),
    )
    robot.wait(1.0)
    assert 2 <= len(taken(movements)) <= 4
    told = taken(statuses)[-1]
    assert (told.state, told.goal, told.goals) == (MoveStatus.DRIVING, 1, 2)
    assert (told.distance_left, told.time_left) == (2.0, 5.0)
    assert told.elapsed == pytest.approx(1.1, abs=0.5)

    robot.publish("motion_status", MotionStatus(leg=wanted.leg, state=MotionStatus.DONE))
    assert taken(statuses)[-1].state == MoveStatus.SUCCEEDED
    assert taken(movements)[-1].behavior == Movement.STAND


def test_where_to_give_way_is_wanted_of_the_planner(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    movements = robot.read("movement", Movement)
    for x in range(11):
        pose = PoseWithCovariance(pose=pose_message((0.2 * x, 0.0, 0.0)))
        robot.publish("pose", PoseWithCovarianceStamped(pose=pose))
    robot.publish("localization_health", LocalizationHealth(located=True, health=0.9))
    robot.publish("order", order(1, (4.0, 0.0, 0.5)), LATCHED)

    goals = []
    for _ in range(120):
        robot.publish("localization_health", LocalizationHealth(located=True, health=0.9))
        for wanted in taken(movements):
            if wanted.behavior == Movement.FOLLOW:
                goals.append(planar_pose(wanted.goal)[0])
                robot.publish("plan", Plan(leg=wanted.leg, outcome=Plan.GOAL_BLOCKED), LATCHED)
        robot.wait(0.1)

    assert goals[0] == pytest.approx(4.0)
    assert pytest.approx(0.6) in goals


@pytest.mark.parametrize(
    ("sets", "state"),
    [
        ((), MoveStatus.SUCCEEDED),
        (("components.automove.parameters.sure_health=0.8",), MoveStatus.RECOVERING),
    ],
)
def test_how_sure_a_robot_at_its_goal_must_be_is_configured(
    deployed: DeployedOf, sets: tuple[str, ...], state: int
) -> None:
    robot = deployed(PLUGINS, *sets)
    statuses, movements = robot.read("move_status", MoveStatus), robot.read("movement", Movement)
    robot.publish("localization_health", LocalizationHealth(located=True, health=0.7))
    robot.publish("order", order(1, (1.0, 2.0, 0.5)), LATCHED)
    robot.wait(0.1)
    leg = taken(movements)[-1].leg
    robot.publish("plan", Plan(leg=leg), LATCHED)
    robot.wait(0.2)

    robot.publish("motion_status", MotionStatus(leg=leg, state=MotionStatus.DONE))

    assert taken(statuses)[-1].state == state


def test_an_age_that_grows_within_a_reason_is_no_news(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses, movements = robot.read("move_status", MoveStatus), robot.read("movement", Movement)
    robot.publish("localization_health", LocalizationHealth(located=True, health=0.9))
    robot.publish("order", order(1, (1.0, 2.0, 0.5)), LATCHED)
    robot.wait(0.1)
    leg = taken(movements)[-1].leg
    robot.publish("plan", Plan(leg=leg), LATCHED)
    for tenths in range(6, 26):
        reason = f"no scan for {tenths / 10:.1f} s on /robot/scan"
        robot.publish(
            "motion_status", MotionStatus(leg=leg, state=MotionStatus.STOPPED, reason=reason)
        )
        robot.wait(0.1)
    assert len(taken(statuses)) < 12


def test_a_new_order_pre_empts_and_one_without_goals_takes_back(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses, movements = robot.read("move_status", MoveStatus), robot.read("movement", Movement)
    robot.publish("order", order(1, (1.0, 2.0, 0.5)), LATCHED)
    robot.publish("order", order(2, (3.0, 4.0, 0.5)), LATCHED)
    robot.publish("order", order(2, (3.0, 4.0, 0.5)), LATCHED)  # told again: nothing new
    robot.wait(0.2)
    assert taken(statuses)[-1].order_id == 2
    legs = len({movement.leg for movement in taken(movements)})

    robot.publish("order", order(1), LATCHED)  # of an order that is over: no matter
    robot.wait(0.2)
    assert taken(statuses) == []
    robot.publish("order", order(2), LATCHED)

    last = taken(statuses)[-1]
    assert (last.order_id, last.state) == (2, MoveStatus.CANCELLED)
    stand = taken(movements)[-1]
    assert stand.behavior == Movement.STAND
    assert legs == 2


def test_an_order_that_is_over_is_nothing_to_do(deployed: DeployedOf) -> None:
    robot = deployed(PLUGINS)
    statuses = robot.read("move_status", MoveStatus)
    robot.publish("order", order(9), LATCHED)
    robot.publish("order", order(10, (1.0, 1.0, 0.0), first=1), LATCHED)
    robot.wait(1.0)
    assert taken(statuses) == []
