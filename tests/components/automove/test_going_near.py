"""A robot without a way to its goal goes as near as it can: the map may hold what has left."""

from __future__ import annotations

import math

import pytest

from cairn.schemas.cairn_nav_msgs import MotionStatus, NavCommand, NavigationStatus, Plan
from tests.components.automove.journey import Journey

STAND, LOOK, FOLLOW = NavCommand.STAND, NavCommand.LOOK_AROUND, NavCommand.FOLLOW


def no_way(**nearest: float) -> Journey:
    """A robot at (0, 0) whose goal (3, 4) holds something."""
    journey = Journey()
    journey.plan = {"outcome": Plan.GOAL_BLOCKED, "reason": "something is there", **nearest}
    return journey


def goes_near() -> Journey:
    """The same when it sets out for the nearest place, and there is a way."""
    journey = no_way(nearest_x=2.0, nearest_y=4.0)
    while journey.navigator.alternative is None:
        journey.run(0.1)
    journey.plan = {"outcome": Plan.FOUND, "length": 7.0}
    return journey


def test_going_near_drives_to_the_nearest_position_and_replans() -> None:
    journey = goes_near()
    assert journey.tried == [STAND, STAND, FOLLOW]
    assert journey.navigator.target == pytest.approx((2.0, 4.0, 0.0))
    assert journey.navigator.reason.text == "go near (3 of 4): no path: something is there"
    journey.run(40.0)
    assert journey.navigator.behavior == FOLLOW
    journey.motion = {"state": MotionStatus.DONE}
    journey.run(0.1)
    assert (journey.navigator.state, journey.navigator.behavior) == (
        NavigationStatus.RECOVERING,
        STAND,
    )
    journey.motion = {"state": MotionStatus.MOVING}
    journey.run(5.0)

    assert journey.navigator.state == NavigationStatus.DRIVING
    assert journey.navigator.target == (3.0, 4.0, 0.0)


def test_endless_approach_is_given_up() -> None:
    journey = goes_near()
    journey.run(54.0)
    assert journey.navigator.reason.text.startswith("go near")
    assert journey.navigator.behavior == STAND


@pytest.mark.parametrize("nearest", [(0.6, 0.7), (math.nan, math.nan)])
def test_robot_near_the_goal_looks_around_instead(
    nearest: tuple[float, float],
) -> None:
    journey = no_way(nearest_x=nearest[0], nearest_y=nearest[1])
    journey.run(200.0)

    assert journey.tried == [STAND, STAND, LOOK, LOOK]
    assert journey.navigator.state == NavigationStatus.FAILED
    assert journey.navigator.reason.text == "no path: something is there (after 4 recoveries)"
