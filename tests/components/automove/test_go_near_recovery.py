"""A robot without a path to its goal drives as near as it can: the map may be outdated."""

from __future__ import annotations

import math

import pytest

from cairn.schemas.cairn_nav_msgs import MotionStatus, NavCommand, NavigationStatus, Plan
from tests.components.automove.scripted_robot import ScriptedRobot
from tests.wording import assert_words

STAND, LOOK, FOLLOW = NavCommand.STAND, NavCommand.LOOK_AROUND, NavCommand.FOLLOW


def robot_with_blocked_goal(**nearest: float) -> ScriptedRobot:
    """A robot at (0, 0) whose goal (3, 4) is occupied."""
    robot = ScriptedRobot()
    robot.plan = {"outcome": Plan.GOAL_BLOCKED, "reason": "an obstacle", **nearest}
    return robot


def approaching_robot() -> ScriptedRobot:
    """The same robot when it starts to drive to the nearest position."""
    robot = robot_with_blocked_goal(nearest_x=2.0, nearest_y=4.0)
    while robot.mission.alternative is None:
        robot.run(0.1)
    robot.plan = {"outcome": Plan.FOUND, "length": 7.0}
    return robot


def test_go_near_recovery_drives_to_the_nearest_position_and_replans() -> None:
    robot = approaching_robot()
    assert robot.recovery_behaviors == [STAND, STAND, FOLLOW]
    assert robot.mission.target == pytest.approx((2.0, 4.0, 0.0))
    assert_words(robot.mission.reason.text, "go near (3 of 4)", "no path", "an obstacle")
    robot.run(40.0)
    assert robot.mission.behavior == FOLLOW
    robot.motion = {"state": MotionStatus.DONE}
    robot.run(0.1)
    assert (robot.mission.state, robot.mission.behavior) == (
        NavigationStatus.RECOVERING,
        STAND,
    )
    robot.motion = {"state": MotionStatus.MOVING}
    robot.run(5.0)

    assert robot.mission.state == NavigationStatus.DRIVING
    assert robot.mission.target == (3.0, 4.0, 0.0)


def test_endless_approach_is_given_up() -> None:
    robot = approaching_robot()
    robot.run(54.0)
    assert robot.mission.reason.text.startswith("go near")
    assert robot.mission.behavior == STAND


@pytest.mark.parametrize("nearest", [(0.6, 0.7), (math.nan, math.nan)])
def test_robot_near_the_goal_looks_around_instead(
    nearest: tuple[float, float],
) -> None:
    robot = robot_with_blocked_goal(nearest_x=nearest[0], nearest_y=nearest[1])
    robot.run(200.0)

    assert robot.recovery_behaviors == [STAND, STAND, LOOK, LOOK]
    assert robot.mission.state == NavigationStatus.FAILED
    assert_words(robot.mission.reason.text, "no path", "an obstacle", "4 recoveries")
