"""Missions in the whole system: arrive, preempt, cancel, reject, fail."""

import math
import re
from collections.abc import Callable

import pytest

from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.action_msgs.srv import CancelGoal
from cairn.schemas.cairn_nav_msgs import MotionStatus, NavigationStatus
from tests.navigation.driving import FEW_RECOVERIES, ON_REQUEST, STOPS_S, LockstepRobot
from tests.sweeps import sampled

RobotFactory = Callable[..., LockstepRobot]


def test_mission_publishes_its_states_and_ends_at_the_goal(drive: RobotFactory) -> None:
    robot = drive(ON_REQUEST)
    robot.run_for(1.0)

    robot.go(7.5, 5.0, math.radians(90))
    robot.assert_arrives((7.5, 5.0))

    assert robot.states() == [
        NavigationStatus.LOADING,
        NavigationStatus.LOCALIZING,
        NavigationStatus.PLANNING,
        NavigationStatus.DRIVING,
        NavigationStatus.SUCCEEDED,
    ]
    loaded = [s.reason for s in robot.statuses if s.state == NavigationStatus.LOADING]
    assert loaded == ["map_builder", "localizer", "path_planner", "motion_control"]
    driving = [s for s in robot.statuses if s.state == NavigationStatus.DRIVING]
    assert driving[0].distance_left == pytest.approx(7.9, abs=0.5)
    assert driving[0].time_left == pytest.approx(driving[0].distance_left / 0.4, rel=0.01)
    assert driving[-1].distance_left < 0.5
    assert robot.statuses[-1].reason == "arrived at (7.50, 5.00)"
    assert robot.truth[2] == pytest.approx(math.radians(90), abs=0.15)
    assert robot.stands()


@pytest.mark.accuracy
def test_new_goal_preempts_the_old_one(drive: RobotFactory) -> None:
    robot = drive()
    robot.go(7.5, 5.0)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(4.0)
    first = robot.statuses[-1].mission_id

    robot.go(1.2, 3.0)
    robot.assert_arrives((1.2, 3.0))

    assert robot.statuses[-1].mission_id > first
    assert [s.state for s in robot.statuses if s.mission_id == first][
        -1
    ] == NavigationStatus.DRIVING


def test_canceled_mission_leaves_the_robot_standing(drive: RobotFactory) -> None:
    robot = drive()
    sent = robot.send([7.5, 5.0, 0.0])
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(4.0)

    sent.cancel()
    robot.run_for(0.0)

    assert sent.cancel_code == 0
    assert robot.time_to_stand() <= STOPS_S
    assert robot.await_end(1.0).state == NavigationStatus.CANCELED
    assert robot.motions[-1].state == MotionStatus.STANDING
    assert sent.status == GoalStatus.STATUS_CANCELED
    sent.cancel()
    robot.run_for(0.0)
    assert sent.cancel_code == CancelGoal.Response.ERROR_GOAL_TERMINATED


@pytest.mark.accuracy
def test_several_goals_are_reached_in_order(drive: RobotFactory) -> None:
    robot = drive()
    goals = [[3.0, 1.2, 0.0], [6.4, 1.8, 1.5], [6.6, 3.2, 1.5]]
    robot.send(*goals)

    for number, (x, y, _) in enumerate(goals[:-1], start=1):
        robot.await_goal(number)
        assert math.dist(robot.truth[:2], (x, y)) < 0.25
    robot.assert_arrives((6.6, 3.2))

    assert {s.goals for s in robot.statuses} == {3}


@pytest.mark.accuracy
@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "reason"),
    sampled(
        [
            ((4.4, 3.4), r"no path: the goal \(4.40, 3.40\) .*nearest reachable position, \("),
            (
                (-3.0, 2.0),
                r"no path: the goal \(-3.00, 2.00\) is outside the map; the nearest reachable pos",
            ),
            (
                (200.0, 2.0),
                r"no path: the goal \(200.00, 2.00\) is outside the map; the nearest reachable pos",
            ),
        ]
    ),
    ids=["in the table", "west of the map", "far away"],
)
def test_blocked_goal_fails_with_the_nearest_position(
    drive: RobotFactory, goal: tuple[float, float], reason: str
) -> None:
    robot = drive(FEW_RECOVERIES)
    robot.go(*goal)

    end = robot.await_end(60.0)

    assert end.state == NavigationStatus.FAILED
    assert re.match(reason, end.reason), end.reason
    assert robot.collisions == []
    robot.go(1.5, 1.2)
    robot.assert_arrives((1.5, 1.2))


def test_invalid_goal_is_aborted_and_the_mission_continues(drive: RobotFactory) -> None:
    robot = drive()
    robot.go(3.0, 1.2)
    robot.await_state(NavigationStatus.DRIVING)

    sent = robot.send([1.0, 1e9, 0.0])
    assert sent.status == GoalStatus.STATUS_ABORTED
    assert sent.result is not None
    assert "at most" in sent.result.error_msg
    robot.go(7.0, 5.0, frame="odom")

    robot.assert_arrives((3.0, 1.2))
    assert len({status.mission_id for status in robot.statuses}) == 1
