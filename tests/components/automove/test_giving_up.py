"""An order always comes to its end: what counts as progress, and what bounds the recoveries."""

from __future__ import annotations

from cairn.schemas.cairn_nav_msgs import MotionStatus, NavigationStatus
from tests.components.automove.journey import Way


def test_driving_again_after_a_recovery_is_no_progress() -> None:
    way = Way(10.0).drive(3600.0, blocked=lambda left: left <= 9.0)

    assert way.navigator.state == NavigationStatus.FAILED
    assert way.navigator.reason.text == "a wall (after 6 recoveries)"
    assert way.navigator.recoveries == 6


def test_endless_progress_fails_the_mission() -> None:
    way = Way(100.0, recoveries_per_goal=20)
    for left in range(99, 0, -1):
        way.drive_until_blocked_at(left)

    assert way.navigator.state == NavigationStatus.FAILED
    assert way.navigator.reason.text == (
        "a wall (after 20 recoveries for this goal, the most allowed)"
    )
    assert way.navigator.recoveries == 20


def test_each_goal_has_its_own_recoveries() -> None:
    goals = ((1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    way = Way(2.0, *goals, recoveries_per_goal=1)
    for number in range(len(goals)):
        way.left = 2.0
        way.drive_until_blocked_at(1.0)
        assert way.navigator.recoveries == number + 1
        while way.navigator.goal_index == number:
            way.drive(0.1)

    assert way.navigator.state == NavigationStatus.SUCCEEDED


def test_detour_around_an_obstacle_is_progress() -> None:
    way = Way(10.0, recoveries=2)
    for _ in range(2):
        way.drive_until_blocked_at(1.0)

    way.left = 30.0
    for left in (25.0, 15.0, 5.0):
        way.drive_until_blocked_at(left)
    way.drive(60.0)

    assert way.navigator.state == NavigationStatus.SUCCEEDED
    assert way.navigator.recoveries == 5


def test_robot_on_a_detour_is_not_stuck() -> None:
    way = Way(10.0).drive(22.0)
    assert way.left < 1.5

    way.left = 30.0  # planned again on the way
    way.drive(100.0)

    assert way.navigator.state == NavigationStatus.SUCCEEDED
    assert way.navigator.recoveries == 0


def test_alternating_between_two_blocked_paths_fails() -> None:
    way = Way(5.0)
    for _ in range(100):
        way.left = 5.0
        way.drive(30.0, blocked=lambda left: left <= 1.0)
        way.left = 20.0
        way.drive(30.0, blocked=lambda left: left <= 16.0)

    assert way.navigator.state == NavigationStatus.FAILED
    assert way.navigator.recoveries <= 30


def test_ever_changing_paths_fail_the_mission() -> None:
    way = Way(5.0)
    for _ in range(300):
        for length in (5.0, 20.0):
            way.left = length
            way.drive(5.0)

    assert way.navigator.state == NavigationStatus.FAILED
    assert (
        way.navigator.reason.text
        == "the robot moves but does not get nearer to its goal (after 6 recoveries)"
    )
    assert way.motion is not None
    assert way.motion["state"] != MotionStatus.BLOCKED
