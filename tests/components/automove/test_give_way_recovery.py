"""A robot that blocks a person backs off along its path, waits, and plans again."""

from __future__ import annotations

import math

import pytest

from cairn.components.automove.inputs import Trail
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigationStatus,
    Plan,
)
from tests.components.automove.scripted_robot import DrivingRobot, ScriptedRobot
from tests.wording import assert_words

LOST = LocalizationEstimate(located=True, health=0.1, reason="lost")
NO_PATH = {"outcome": Plan.UNREACHABLE, "reason": "a person is there"}
STEP = 0.11


def leave_trail(robot: ScriptedRobot) -> None:
    """Let the robot have driven 2.2 m along the x axis."""
    for step in range(21):
        robot.inputs.set_pose((step * STEP, 0.0, 0.0))


def retreating_robot(**plan: object) -> ScriptedRobot:
    """A robot without a path that retreats because waiting did not help."""
    robot = ScriptedRobot()
    leave_trail(robot)
    robot.plan = NO_PATH
    while robot.mission.alternative is None:
        robot.run(0.1)
    robot.plan = {"outcome": Plan.FOUND, **plan}
    return robot


def test_give_way_recovery_retreats_waits_and_replans() -> None:
    robot = retreating_robot()
    assert robot.recovery_behaviors == [NavCommand.STAND, NavCommand.FOLLOW]
    assert robot.mission.behavior == NavCommand.FOLLOW
    x, y, theta = robot.mission.target
    assert (x, y) == pytest.approx((8 * STEP, 0.0))
    assert theta == pytest.approx(math.atan2(4.0, 3.0 - x))  # the robot faces its goal
    assert robot.mission.goal == (3.0, 4.0, 0.0)
    assert_words(robot.mission.reason.text, "give way (2 of 4)", "no path", "a person is there")

    robot.run(4.0)
    assert robot.mission.behavior == NavCommand.FOLLOW
    robot.motion = {"state": MotionStatus.DONE}
    robot.run(0.1)
    assert (robot.mission.state, robot.mission.behavior) == (
        NavigationStatus.RECOVERING,
        NavCommand.STAND,
    )
    assert robot.mission.target == robot.mission.goal
    robot.motion = {"state": MotionStatus.MOVING}
    robot.run(3.5)
    assert robot.mission.behavior == NavCommand.STAND

    robot.run(1.0)

    assert (robot.mission.state, robot.mission.recoveries) == (NavigationStatus.DRIVING, 2)
    assert robot.mission.target == (3.0, 4.0, 0.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"plan": {"outcome": Plan.START_BLOCKED}},
        {"plan": {"outcome": Plan.FOUND, "length": 5.0}},
        {"motion": {"state": MotionStatus.BLOCKED}},
        {"localization": LOST},
    ],
)
def test_robot_waits_if_it_cannot_retreat(changes: dict[str, object]) -> None:
    robot = retreating_robot()
    for name, value in changes.items():
        setattr(robot, name, value)

    robot.run(1.5)

    assert robot.mission.state == NavigationStatus.RECOVERING
    assert robot.mission.behavior == NavCommand.STAND
    assert robot.mission.reason.text.startswith("give way (2 of 4)")


def test_endless_retreat_is_given_up() -> None:
    robot = retreating_robot()
    robot.run(31.0)
    assert robot.mission.behavior == NavCommand.STAND


def test_robot_without_a_trail_waits_instead() -> None:
    robot = ScriptedRobot()
    robot.plan = NO_PATH
    robot.run(200.0)
    stand, look = NavCommand.STAND, NavCommand.LOOK_AROUND
    assert robot.recovery_behaviors == [stand, stand, look, look]
    assert robot.mission.state == NavigationStatus.FAILED


def test_driving_again_after_a_retreat_does_not_count_as_progress() -> None:
    robot = DrivingRobot(10.0)
    leave_trail(robot)
    robot.drive(3600.0, blocked=lambda left: left <= 9.0)

    assert NavCommand.FOLLOW in robot.recovery_behaviors
    assert_words(robot.mission.reason.text, "a wall", "6 recoveries")
    assert robot.mission.recoveries == 6


def retreat_from_trail(*meters: float) -> Pose | None:
    trail = Trail()
    for x in meters:
        trail.add((x, 0.0, 0.0))
    return trail.retreat((9.0, 0.0, 1.0))


def test_retreat_is_to_the_last_position_far_enough() -> None:
    out_and_back = [STEP * step for step in (*range(30), *range(30, 10, -1))]
    assert retreat_from_trail(*out_and_back) == pytest.approx((23 * STEP, 0.0, 0.0))
    assert retreat_from_trail(*(STEP * step for step in range(9))) == (0.0, 0.0, 0.0)
    assert retreat_from_trail(0.0, 0.4) is None
    assert retreat_from_trail() is None


def test_trail_before_a_pose_correction_is_forgotten() -> None:
    assert retreat_from_trail(*(STEP * step for step in range(30)), 7.0, 7.3) is None
