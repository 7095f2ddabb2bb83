"""The navigator state machine, step by step, on given situations."""

from __future__ import annotations

import itertools
import math

import pytest

from cairn.components.automove.inputs import NavigatorInputs
from cairn.components.automove.state_machine import NavigatorStateMachine
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigationStatus,
    Plan,
)
from tests.components.automove.journey import SURE, Journey

LOST = LocalizationEstimate(located=True, health=0.1, reason="the map explains 20% of the scan")


def test_located_robot_plans_drives_and_succeeds() -> None:
    journey = Journey().run(1.0)
    assert journey.states == [NavigationStatus.PLANNING, NavigationStatus.DRIVING]
    assert journey.navigator.behavior == NavCommand.FOLLOW

    journey.motion = {"state": MotionStatus.DONE}
    journey.run(0.1)

    assert journey.navigator.state == NavigationStatus.SUCCEEDED
    assert journey.navigator.reason.text == "arrived at (3.00, 4.00)"
    assert journey.navigator.behavior == NavCommand.STAND
    assert journey.navigator.finished


def test_each_command_has_a_new_goal_id_and_old_answers_are_ignored() -> None:
    journey = Journey((1.0, 0.0, 0.0), (2.0, 0.0, 0.0)).run(1.0)
    first = journey.navigator.goal_id
    journey.motion = {"state": MotionStatus.DONE}
    journey.run(0.1)
    assert (journey.navigator.goal_index, journey.navigator.state) == (1, NavigationStatus.PLANNING)
    assert journey.navigator.goal_id != first

    journey.navigator.step(journey.now, journey.inputs)  # plan and motion are still those of before

    assert (journey.navigator.goal_index, journey.navigator.state) == (1, NavigationStatus.PLANNING)


def test_mission_starts_at_the_given_goal_index() -> None:
    navigator = NavigatorStateMachine(
        mission_id=1,
        goals=((1.0, 0.0, 0.0), (2.0, 0.0, 0.0)),
        goal_index=1,
        next_goal_id=itertools.count(1).__next__,
        started_s=0.0,
    )
    assert navigator.goal == (2.0, 0.0, 0.0)


@pytest.mark.parametrize("health", [None, LOST])
def test_robot_stands_until_it_is_located(health: LocalizationEstimate | None) -> None:
    journey = Journey()
    journey.health = health
    journey.run(1.5)
    assert journey.navigator.state == NavigationStatus.LOCALIZING
    assert journey.navigator.behavior == NavCommand.STAND
    assert journey.navigator.reason.text in (LOST.reason, "no estimate from the localizer yet")


def test_silent_localizer_triggers_no_recovery() -> None:
    journey = Journey(stopped_s=5.0)
    journey.health = None
    journey.run(6.0)
    assert journey.states == [NavigationStatus.LOCALIZING, NavigationStatus.FAILED]
    assert journey.navigator.reason.text == "no estimate from the localizer yet"

    journey = Journey()
    journey.run(1.0)
    journey.health = None
    journey.run(1.5)
    assert (
        journey.navigator.state == NavigationStatus.DRIVING
    )  # motion control stops by itself, and says so


def test_lost_robot_tries_all_recoveries_and_fails() -> None:
    journey = Journey().run(1.0)
    journey.health = LOST
    journey.run(2.0)
    assert (journey.navigator.state, journey.navigator.behavior) == (
        NavigationStatus.LOCALIZING,
        NavCommand.STAND,
    )

    journey.run(600.0)

    look, explore = NavCommand.LOOK_AROUND, NavCommand.EXPLORE
    assert journey.tried == 2 * [NavCommand.STAND, look, explore, look, explore, look]
    assert journey.navigator.state == NavigationStatus.FAILED
    assert journey.navigator.reason.text == "the map explains 20% of the scan (after 12 recoveries)"
    assert journey.navigator.recoveries == 12


def test_each_exploration_drives_twice_as_far() -> None:
    journey = Journey().run(1.0)
    journey.health = LOST

    far = []
    for _ in range(400):
        journey.run(1.0)
        if (
            journey.navigator.behavior == NavCommand.EXPLORE
            and journey.navigator.explore_m not in far
        ):
            far.append(journey.navigator.explore_m)

    assert far == [2.0, 4.0, 8.0]


def test_located_robot_stops_recovering_and_drives_on() -> None:
    journey = Journey().run(1.0)
    journey.health = LOST
    journey.run(10.0)
    assert journey.navigator.behavior == NavCommand.LOOK_AROUND

    journey.health = SURE
    journey.run(2.0)

    assert journey.navigator.state == NavigationStatus.DRIVING


def test_short_doubt_does_not_stop_the_robot() -> None:
    journey = Journey().run(1.0)
    journey.health = LOST
    journey.run(0.8)
    journey.health = SURE
    journey.run(1.0)
    assert journey.states == [NavigationStatus.PLANNING, NavigationStatus.DRIVING]


def test_blocked_robot_recovers_and_progress_resets_the_tries() -> None:
    journey = Journey().run(1.0)
    journey.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall", "distance_left": 4.0}
    journey.run(2.5)
    assert (journey.navigator.state, journey.navigator.reason.text) == (
        NavigationStatus.DRIVING,
        "a wall",
    )
    journey.run(10.0)
    assert journey.tried[0] == NavCommand.STAND
    assert journey.navigator.recoveries > 1

    for left in (4.0, 3.5):
        journey.motion = {"state": MotionStatus.MOVING, "distance_left": left}
        journey.run(6.0)
    assert journey.navigator.state == NavigationStatus.DRIVING
    journey.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall", "distance_left": 3.5}
    journey.run(3.2)
    assert journey.navigator.reason.text == "wait (1 of 6): a wall"


def test_mission_fails_after_all_recoveries_with_the_reason() -> None:
    journey = Journey().run(1.0)
    journey.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall"}
    journey.run(200.0)
    assert journey.tried == [
        NavCommand.STAND,
        NavCommand.LOOK_AROUND,
        NavCommand.BACK_OFF,
        NavCommand.STAND,
        NavCommand.LOOK_AROUND,
        NavCommand.STAND,
    ]
    assert journey.navigator.reason.text == "a wall (after 6 recoveries)"


def test_mission_without_recoveries_fails_at_once() -> None:
    journey = Journey(recoveries=0).run(1.0)
    journey.motion = {"state": MotionStatus.BLOCKED, "reason": "a wall"}
    journey.run(3.5)
    assert (journey.navigator.state, journey.navigator.reason.text) == (
        NavigationStatus.FAILED,
        "a wall",
    )


def test_moving_without_progress_triggers_a_recovery() -> None:
    journey = Journey().run(1.0)
    journey.motion = {"state": MotionStatus.MOVING, "distance_left": 2.0}
    journey.run(21.0)
    assert journey.navigator.state == NavigationStatus.RECOVERING
    assert (
        journey.navigator.reason.text
        == "wait (1 of 6): the robot moves but does not get nearer to its goal"
    )


@pytest.mark.parametrize(
    ("outcome", "tries"), [(Plan.UNREACHABLE, 4), (Plan.GOAL_BLOCKED, 4), (Plan.START_BLOCKED, 6)]
)
def test_missing_path_fails_with_the_reason_of_the_planner(outcome: int, tries: int) -> None:
    journey = Journey()
    journey.plan = {"outcome": outcome, "reason": "the goal is in a wall"}
    journey.motion = {"state": MotionStatus.DONE}
    journey.run(1.0)
    assert journey.navigator.reason.text == "no path: the goal is in a wall"
    journey.run(200.0)
    assert len(journey.tried) == tries
    assert journey.navigator.state == NavigationStatus.FAILED
    assert (
        journey.navigator.reason.text
        == f"no path: the goal is in a wall (after {tries} recoveries)"
    )


def test_goal_outside_the_map_fails_at_once() -> None:
    journey = Journey()
    journey.plan = {"outcome": Plan.OUTSIDE_MAP, "reason": "the goal is outside the map"}
    journey.run(0.3)
    assert journey.states == [NavigationStatus.PLANNING, NavigationStatus.FAILED]
    assert journey.navigator.reason.text == "no path: the goal is outside the map"


def test_robot_outside_the_map_recovers_and_drives_on() -> None:
    journey = Journey()
    outside = "the robot at (-0.10, 3.00) is outside the map"
    journey.plan = {"outcome": Plan.START_BLOCKED, "reason": outside}
    journey.run(5.0)
    assert journey.navigator.state == NavigationStatus.RECOVERING
    assert journey.navigator.reason.text == f"wait (1 of 6): no path: {outside}"

    journey.plan = {"outcome": Plan.FOUND}
    journey.run(5.0)

    assert journey.navigator.state == NavigationStatus.DRIVING


def test_silent_planner_is_reported() -> None:
    journey = Journey(planning_s=5.0)
    journey.plan = None
    journey.run(6.0)
    assert journey.navigator.reason.text == "wait (1 of 6): the path planner has not answered"


def test_missing_input_fails_the_mission_with_its_name() -> None:
    journey = Journey(stopped_s=5.0).run(1.0)
    journey.motion = {"state": MotionStatus.STOPPED, "reason": "no scan for 0.6 s on /robot/scan"}
    journey.run(4.0)
    assert journey.navigator.state == NavigationStatus.DRIVING
    assert journey.navigator.reason.text == "no scan for 0.6 s on /robot/scan"

    journey.motion = {"state": MotionStatus.MOVING}
    journey.run(1.0)
    assert (journey.navigator.state, journey.navigator.reason.text) == (
        NavigationStatus.DRIVING,
        "",
    )

    journey.motion = {"state": MotionStatus.STOPPED, "reason": "no scan for 0.6 s on /robot/scan"}
    journey.run(5.5)
    assert journey.navigator.state == NavigationStatus.FAILED
    assert journey.navigator.reason.text == "no scan for 0.6 s on /robot/scan"


def test_input_missing_during_a_recovery_is_named() -> None:
    journey = Journey(stopped_s=5.0).run(1.0)
    journey.health = LOST
    journey.run(10.0)
    journey.motion = {"state": MotionStatus.STOPPED, "reason": "no odom for 0.6 s on /robot/odom"}
    journey.run(1.0)
    assert journey.navigator.reason.text == "no odom for 0.6 s on /robot/odom"
    journey.run(5.0)
    assert journey.navigator.state == NavigationStatus.FAILED


def test_silent_motion_control_is_reported_with_the_time() -> None:
    journey = Journey(stopped_s=5.0).run(1.0)
    journey.motion = None
    journey.run(3.0)
    assert journey.navigator.state == NavigationStatus.DRIVING
    assert journey.navigator.reason.text == "no status from motion control for 3.0 s"
    journey.run(5.0)
    assert journey.navigator.state == NavigationStatus.FAILED


def test_canceled_mission_stays_canceled() -> None:
    journey = Journey().run(1.0)
    goal_id = journey.navigator.goal_id
    journey.navigator.cancel()
    journey.run(1.0)
    assert journey.navigator.state == NavigationStatus.CANCELED
    assert journey.navigator.behavior == NavCommand.STAND
    assert journey.navigator.goal_id != goal_id


def test_distance_left_is_along_the_path_while_driving() -> None:
    journey = Journey()
    assert journey.navigator.distance_left(journey.inputs) == pytest.approx(5.0)
    journey.motion = {"state": MotionStatus.MOVING, "distance_left": 7.0}
    journey.run(1.0)
    assert journey.navigator.distance_left(journey.inputs) == 7.0
    journey.motion = {"state": MotionStatus.STOPPED, "reason": "no scan"}
    journey.run(0.5)
    assert journey.navigator.distance_left(journey.inputs) == pytest.approx(5.0)
    assert journey.navigator.distance_left(NavigatorInputs()) == 0.0
    assert math.isinf(NavigatorInputs().localization_s)


def test_uncertain_pose_does_not_reach_a_goal() -> None:
    journey = Journey().run(1.0)
    journey.health = LocalizationEstimate(located=True, health=0.45, reason="found but now")
    journey.motion = {"state": MotionStatus.DONE}
    journey.run(0.1)
    assert journey.navigator.state == NavigationStatus.RECOVERING
    assert journey.navigator.behavior == NavCommand.LOOK_AROUND
    assert "found but now" in journey.navigator.reason.text
