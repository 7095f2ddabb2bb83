"""A mission always ends: what counts as progress, and what limits the recoveries."""

from __future__ import annotations

from cairn.schemas.cairn_nav_msgs import MotionStatus, NavigationStatus
from tests.components.automove.scripted_robot import DrivingRobot
from tests.wording import assert_words


def test_driving_again_after_a_recovery_does_not_count_as_progress() -> None:
    robot = DrivingRobot(10.0).drive(3600.0, blocked=lambda left: left <= 9.0)

    assert robot.mission.state == NavigationStatus.FAILED
    assert_words(robot.mission.reason.text, "a wall", "6 recoveries")
    assert robot.mission.recoveries == 6


def test_endless_progress_fails_the_mission() -> None:
    robot = DrivingRobot(100.0, recoveries_per_goal=20)
    for left in range(99, 0, -1):
        robot.drive_until_blocked_at(left)

    assert robot.mission.state == NavigationStatus.FAILED
    assert_words(robot.mission.reason.text, "a wall", "20 recoveries for this goal")
    assert robot.mission.recoveries == 20


def test_each_goal_has_its_own_recoveries() -> None:
    goals = ((1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    robot = DrivingRobot(2.0, *goals, recoveries_per_goal=1)
    for number in range(len(goals)):
        robot.path_left_m = 2.0
        robot.drive_until_blocked_at(1.0)
        assert robot.mission.recoveries == number + 1
        while robot.mission.goal_index == number:
            robot.drive(0.1)

    assert robot.mission.state == NavigationStatus.SUCCEEDED


def test_detour_around_an_obstacle_counts_as_progress() -> None:
    robot = DrivingRobot(10.0, recoveries=2)
    for _ in range(2):
        robot.drive_until_blocked_at(1.0)

    robot.path_left_m = 30.0
    for left in (25.0, 15.0, 5.0):
        robot.drive_until_blocked_at(left)
    robot.drive(60.0)

    assert robot.mission.state == NavigationStatus.SUCCEEDED
    assert robot.mission.recoveries == 5


def test_robot_on_a_detour_is_not_stuck() -> None:
    robot = DrivingRobot(10.0).drive(22.0)
    assert robot.path_left_m < 1.5

    robot.path_left_m = 30.0  # a new path
    robot.drive(100.0)

    assert robot.mission.state == NavigationStatus.SUCCEEDED
    assert robot.mission.recoveries == 0


def test_alternating_between_two_blocked_paths_fails() -> None:
    robot = DrivingRobot(5.0)
    for _ in range(100):
        robot.path_left_m = 5.0
        robot.drive(30.0, blocked=lambda left: left <= 1.0)
        robot.path_left_m = 20.0
        robot.drive(30.0, blocked=lambda left: left <= 16.0)

    assert robot.mission.state == NavigationStatus.FAILED
    assert robot.mission.recoveries <= 30


def test_ever_changing_paths_fail_the_mission() -> None:
    robot = DrivingRobot(5.0)
    for _ in range(300):
        for length in (5.0, 20.0):
            robot.path_left_m = length
            robot.drive(5.0)

    assert robot.mission.state == NavigationStatus.FAILED
    assert_words(robot.mission.reason.text, "not get nearer", "6 recoveries")
    assert robot.motion is not None
    assert robot.motion["state"] != MotionStatus.BLOCKED
