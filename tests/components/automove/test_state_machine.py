"""The mission state machine, step by step, with scripted inputs."""

from __future__ import annotations

import itertools
import math

import pytest

from cairn.components.automove.inputs import MissionInputs
from cairn.components.automove.state_machine import MissionStateMachine
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigationStatus,
    Plan,
    ReasonCode,
)
from tests.components.automove.scripted_robot import LOCATED, ScriptedRobot
from tests.wording import assert_words

LOST = LocalizationEstimate(located=True, health=0.1, reason="the map explains 20% of the scan")


def test_located_robot_plans_drives_and_succeeds() -> None:
    robot = ScriptedRobot().run(1.0)
    assert robot.states == [NavigationStatus.PLANNING, NavigationStatus.DRIVING]
    assert robot.mission.behavior == NavCommand.FOLLOW

    robot.motion = {"state": MotionStatus.DONE}
    robot.run(0.1)

    assert robot.mission.state == NavigationStatus.SUCCEEDED
    assert robot.mission.reason.text == "arrived at (3.00, 4.00)"
    assert robot.mission.behavior == NavCommand.STAND
    assert robot.mission.finished


def test_each_command_has_a_new_command_id_and_old_answers_are_ignored() -> None:
    robot = ScriptedRobot((1.0, 0.0, 0.0), (2.0, 0.0, 0.0)).run(1.0)
    first = robot.mission.command_id
    robot.motion = {"state": MotionStatus.DONE}
    robot.run(0.1)
    assert (robot.mission.goal_index, robot.mission.state) == (1, NavigationStatus.PLANNING)
    assert robot.mission.command_id != first

    robot.mission.step(robot.now, robot.inputs)  # with the old plan and motion status

    assert (robot.mission.goal_index, robot.mission.state) == (1, NavigationStatus.PLANNING)


def test_mission_starts_at_the_given_goal_index() -> None:
    mission = MissionStateMachine(
        mission_id=1,
        goals=((1.0, 0.0, 0.0), (2.0, 0.0, 0.0)),
        goal_index=1,
        next_command_id=itertools.count(1).__next__,
        started_s=0.0,
    )
    assert mission.goal == (2.0, 0.0, 0.0)


@pytest.mark.parametrize("health", [None, LOST])
def test_robot_stands_until_it_is_located(health: LocalizationEstimate | None) -> None:
    robot = ScriptedRobot()
    robot.localization = health
    robot.run(1.5)
    assert robot.mission.state == NavigationStatus.LOCALIZING
    assert robot.mission.behavior == NavCommand.STAND
    assert robot.mission.reason.text in (LOST.reason, "no estimate from the localizer yet")


def test_silent_localizer_triggers_no_recovery() -> None:
    robot = ScriptedRobot(stopped_s=5.0)
    robot.localization = None
    robot.run(6.0)
    assert robot.states == [NavigationStatus.LOCALIZING, NavigationStatus.FAILED]
    assert_words(robot.mission.reason.text, "no estimate", "localizer")

    robot = ScriptedRobot()
    robot.run(1.0)
    robot.localization = None
    robot.run(1.5)
    assert (
        robot.mission.state == NavigationStatus.DRIVING
    )  # motion control stops by itself and reports it


def test_lost_robot_tries_all_recoveries_and_fails() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.localization = LOST
    robot.run(2.0)
    assert (robot.mission.state, robot.mission.behavior) == (
        NavigationStatus.LOCALIZING,
        NavCommand.STAND,
    )

    robot.run(600.0)

    look, explore = NavCommand.LOOK_AROUND, NavCommand.EXPLORE
    assert robot.recovery_behaviors == 2 * [NavCommand.STAND, look, explore, look, explore, look]
    assert robot.mission.state == NavigationStatus.FAILED
    assert_words(robot.mission.reason.text, "the map explains 20% of the scan", "12 recoveries")
    assert robot.mission.recoveries == 12


def test_each_exploration_drives_twice_as_far() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.localization = LOST

    far = []
    for _ in range(400):
        robot.run(1.0)
        if robot.mission.behavior == NavCommand.EXPLORE and robot.mission.explore_m not in far:
            far.append(robot.mission.explore_m)

    assert far == [2.0, 4.0, 8.0]


def test_located_robot_stops_recovering_and_drives_on() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.localization = LOST
    robot.run(10.0)
    assert robot.mission.behavior == NavCommand.LOOK_AROUND

    robot.localization = LOCATED
    robot.run(2.0)

    assert robot.mission.state == NavigationStatus.DRIVING


def test_short_loss_of_health_does_not_stop_the_robot() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.localization = LOST
    robot.run(0.8)
    robot.localization = LOCATED
    robot.run(1.0)
    assert robot.states == [NavigationStatus.PLANNING, NavigationStatus.DRIVING]


def test_blocked_robot_recovers_and_progress_resets_the_recoveries() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall", "distance_left": 4.0}
    robot.run(2.5)
    assert (robot.mission.state, robot.mission.reason.text) == (
        NavigationStatus.DRIVING,
        "a wall",
    )
    robot.run(10.0)
    assert robot.recovery_behaviors[0] == NavCommand.STAND
    assert robot.mission.recoveries > 1

    for left in (4.0, 3.5):
        robot.motion = {"state": MotionStatus.MOVING, "distance_left": left}
        robot.run(6.0)
    assert robot.mission.state == NavigationStatus.DRIVING
    robot.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall", "distance_left": 3.5}
    robot.run(3.2)
    assert_words(robot.mission.reason.text, "wait (1 of 6)", "a wall")


def test_mission_fails_after_all_recoveries_with_the_reason() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall"}
    robot.run(200.0)
    assert robot.recovery_behaviors == [
        NavCommand.STAND,
        NavCommand.LOOK_AROUND,
        NavCommand.BACK_OFF,
        NavCommand.STAND,
        NavCommand.LOOK_AROUND,
        NavCommand.STAND,
    ]
    assert_words(robot.mission.reason.text, "a wall", "6 recoveries")


def test_mission_without_recoveries_fails_at_once() -> None:
    robot = ScriptedRobot(recoveries=0).run(1.0)
    robot.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall"}
    robot.run(3.5)
    assert (robot.mission.state, robot.mission.reason.text) == (
        NavigationStatus.FAILED,
        "a wall",
    )


def test_moving_without_progress_triggers_a_recovery() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.motion = {"state": MotionStatus.MOVING, "distance_left": 2.0}
    robot.run(21.0)
    assert robot.mission.state == NavigationStatus.RECOVERING
    assert_words(robot.mission.reason.text, "wait (1 of 6)", "not get nearer")


@pytest.mark.parametrize(
    ("outcome", "tries"), [(Plan.UNREACHABLE, 4), (Plan.GOAL_BLOCKED, 4), (Plan.START_BLOCKED, 6)]
)
def test_missing_path_fails_with_the_reason_of_the_planner(outcome: int, tries: int) -> None:
    robot = ScriptedRobot()
    robot.plan = {"outcome": outcome, "reason": "the goal is in a wall"}
    robot.motion = {"state": MotionStatus.DONE}
    robot.run(1.0)
    assert_words(robot.mission.reason.text, "no path", "the goal is in a wall")
    robot.run(200.0)
    assert len(robot.recovery_behaviors) == tries
    assert robot.mission.state == NavigationStatus.FAILED
    assert_words(
        robot.mission.reason.text, "no path", "the goal is in a wall", f"{tries} recoveries"
    )


@pytest.mark.parametrize("outcome", [Plan.OUTSIDE_MAP, Plan.GOAL_IMPOSSIBLE, Plan.GOAL_IN_KEEPOUT])
def test_impossible_goal_fails_at_once(outcome: int) -> None:
    robot = ScriptedRobot()
    robot.plan = {"outcome": outcome, "reason": "the goal is outside the map"}
    robot.run(0.3)
    assert robot.states == [NavigationStatus.PLANNING, NavigationStatus.FAILED]
    assert_words(robot.mission.reason.text, "no path", "the goal is outside the map")


def test_goal_that_a_new_keepout_zone_covers_fails_while_the_robot_drives() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.plan = {"outcome": Plan.GOAL_IN_KEEPOUT, "reason": "the goal is in keepout zone a"}
    robot.run(0.2)
    assert robot.mission.state == NavigationStatus.FAILED
    assert robot.mission.reason.code == ReasonCode.GOAL_IN_KEEPOUT


@pytest.mark.parametrize("begins_s", [0.0, 1.0], ids=["planning", "driving"])
def test_goal_waits_while_the_robot_must_stay_in_a_keepout_zone(begins_s: float) -> None:
    robot = ScriptedRobot().run(begins_s)
    robot.plan = {"outcome": Plan.START_IN_KEEPOUT, "reason": "the robot is in keepout zone a"}
    robot.motion = {"state": MotionStatus.STOPPED, "reason_code": ReasonCode.IN_KEEPOUT}
    robot.run(300.0)
    assert robot.mission.reason.code == ReasonCode.IN_KEEPOUT
    assert robot.recovery_behaviors == []

    robot.plan, robot.motion = {"outcome": Plan.FOUND}, {"state": MotionStatus.MOVING}
    robot.run(1.0)
    assert robot.mission.state == NavigationStatus.DRIVING


def test_robot_outside_the_map_recovers_and_drives_on() -> None:
    robot = ScriptedRobot()
    outside = "the robot at (-0.10, 3.00) is outside the map"
    robot.plan = {"outcome": Plan.START_BLOCKED, "reason": outside}
    robot.run(5.0)
    assert robot.mission.state == NavigationStatus.RECOVERING
    assert_words(robot.mission.reason.text, "wait (1 of 6)", "no path", outside)

    robot.plan = {"outcome": Plan.FOUND}
    robot.run(5.0)

    assert robot.mission.state == NavigationStatus.DRIVING


def test_silent_planner_is_reported() -> None:
    robot = ScriptedRobot(planning_s=5.0)
    robot.plan = None
    robot.run(6.0)
    assert_words(robot.mission.reason.text, "wait (1 of 6)", "path planner")


def test_missing_input_fails_the_mission_with_its_name() -> None:
    robot = ScriptedRobot(stopped_s=5.0).run(1.0)
    robot.motion = {"state": MotionStatus.STOPPED, "reason": "no scan for 0.6 s on /robot/scan"}
    robot.run(4.0)
    assert robot.mission.state == NavigationStatus.DRIVING
    assert robot.mission.reason.text == "no scan for 0.6 s on /robot/scan"

    robot.motion = {"state": MotionStatus.MOVING}
    robot.run(1.0)
    assert (robot.mission.state, robot.mission.reason.text) == (
        NavigationStatus.DRIVING,
        "",
    )

    robot.motion = {"state": MotionStatus.STOPPED, "reason": "no scan for 0.6 s on /robot/scan"}
    robot.run(5.5)
    assert robot.mission.state == NavigationStatus.FAILED
    assert robot.mission.reason.text == "no scan for 0.6 s on /robot/scan"


def test_input_missing_during_a_recovery_is_named() -> None:
    robot = ScriptedRobot(stopped_s=5.0).run(1.0)
    robot.localization = LOST
    robot.run(10.0)
    robot.motion = {"state": MotionStatus.STOPPED, "reason": "no odom for 0.6 s on /robot/odom"}
    robot.run(1.0)
    assert robot.mission.reason.text == "no odom for 0.6 s on /robot/odom"
    robot.run(5.0)
    assert robot.mission.state == NavigationStatus.FAILED


def test_silent_motion_control_is_reported_with_the_time() -> None:
    robot = ScriptedRobot(stopped_s=5.0).run(1.0)
    robot.motion = None
    robot.run(3.0)
    assert robot.mission.state == NavigationStatus.DRIVING
    assert_words(robot.mission.reason.text, "motion control", "3.0 s")
    robot.run(5.0)
    assert robot.mission.state == NavigationStatus.FAILED


def test_canceled_mission_stays_canceled() -> None:
    robot = ScriptedRobot().run(1.0)
    command_id = robot.mission.command_id
    robot.mission.cancel()
    robot.run(1.0)
    assert robot.mission.state == NavigationStatus.CANCELED
    assert robot.mission.behavior == NavCommand.STAND
    assert robot.mission.command_id != command_id


def test_distance_left_is_along_the_path_while_driving() -> None:
    robot = ScriptedRobot()
    assert robot.mission.distance_left(robot.inputs) == pytest.approx(5.0)
    robot.motion = {"state": MotionStatus.MOVING, "distance_left": 7.0}
    robot.run(1.0)
    assert robot.mission.distance_left(robot.inputs) == 7.0
    robot.motion = {"state": MotionStatus.STOPPED, "reason": "no scan"}
    robot.run(0.5)
    assert robot.mission.distance_left(robot.inputs) == pytest.approx(5.0)
    assert robot.mission.distance_left(MissionInputs()) == 0.0
    assert math.isinf(MissionInputs().localization_s)


def test_uncertain_pose_does_not_reach_a_goal() -> None:
    robot = ScriptedRobot().run(1.0)
    robot.localization = LocalizationEstimate(located=True, health=0.45, reason="found but now")
    robot.motion = {"state": MotionStatus.DONE}
    robot.run(0.1)
    assert robot.mission.state == NavigationStatus.RECOVERING
    assert robot.mission.behavior == NavCommand.LOOK_AROUND
    assert "found but now" in robot.mission.reason.text
