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
from tests.components.automove.journey import Journey, Way

LOST = LocalizationEstimate(located=True, health=0.1, reason="lost")
NO_WAY = {"outcome": Plan.UNREACHABLE, "reason": "a person is there"}
STEP = 0.11


def came(journey: Journey) -> None:
    """Let the robot have come 2.2 m along the x axis."""
    for step in range(21):
        journey.inputs.set_pose((step * STEP, 0.0, 0.0))


def gives_way(**more: object) -> Journey:
    """A robot for which there is no way, when it goes back as waiting did not help."""
    journey = Journey()
    came(journey)
    journey.plan = NO_WAY
    while journey.navigator.alternative is None:
        journey.run(0.1)
    journey.plan = {"outcome": Plan.FOUND, **more}
    return journey


def test_giving_way_retreats_waits_and_replans() -> None:
    journey = gives_way()
    assert journey.tried == [NavCommand.STAND, NavCommand.FOLLOW]
    assert journey.navigator.behavior == NavCommand.FOLLOW
    x, y, theta = journey.navigator.target
    assert (x, y) == pytest.approx((8 * STEP, 0.0))
    assert theta == pytest.approx(math.atan2(4.0, 3.0 - x))  # it watches its goal from there
    assert journey.navigator.goal == (3.0, 4.0, 0.0)
    assert journey.navigator.reason.text == "give way (2 of 4): no path: a person is there"

    journey.run(4.0)
    assert journey.navigator.behavior == NavCommand.FOLLOW
    journey.motion = {"state": MotionStatus.DONE}
    journey.run(0.1)
    assert (journey.navigator.state, journey.navigator.behavior) == (
        NavigationStatus.RECOVERING,
        NavCommand.STAND,
    )
    assert journey.navigator.target == journey.navigator.goal
    journey.motion = {"state": MotionStatus.MOVING}
    journey.run(3.5)
    assert journey.navigator.behavior == NavCommand.STAND

    journey.run(1.0)

    assert (journey.navigator.state, journey.navigator.recoveries) == (NavigationStatus.DRIVING, 2)
    assert journey.navigator.target == (3.0, 4.0, 0.0)


@pytest.mark.parametrize(
    "there",
    [
        {"plan": {"outcome": Plan.START_BLOCKED}},
        {"plan": {"outcome": Plan.FOUND, "length": 5.0}},
        {"motion": {"state": MotionStatus.BLOCKED}},
        {"health": LOST},
    ],
)
def test_robot_waits_if_it_cannot_retreat(there: dict[str, object]) -> None:
    journey = gives_way()
    for name, value in there.items():
        setattr(journey, name, value)

    journey.run(1.5)

    assert journey.navigator.state == NavigationStatus.RECOVERING
    assert journey.navigator.behavior == NavCommand.STAND
    assert journey.navigator.reason.text.startswith("give way (2 of 4)")


def test_endless_retreat_is_given_up() -> None:
    journey = gives_way()
    journey.run(31.0)
    assert journey.navigator.behavior == NavCommand.STAND


def test_robot_without_a_trail_waits_instead() -> None:
    journey = Journey()
    journey.plan = NO_WAY
    journey.run(200.0)
    stand, look = NavCommand.STAND, NavCommand.LOOK_AROUND
    assert journey.tried == [stand, stand, look, look]
    assert journey.navigator.state == NavigationStatus.FAILED


def test_driving_again_after_a_retreat_is_no_progress() -> None:
    way = Way(10.0)
    came(way)
    way.drive(3600.0, blocked=lambda left: left <= 9.0)

    assert NavCommand.FOLLOW in way.tried
    assert way.navigator.reason.text == "a wall (after 6 recoveries)"
    assert way.navigator.recoveries == 6


def back_from(*meters: float) -> Pose | None:
    trail = Trail()
    for x in meters:
        trail.add((x, 0.0, 0.0))
    return trail.retreat((9.0, 0.0, 1.0))


def test_retreat_is_to_the_last_position_far_enough() -> None:
    there_and_back = [STEP * step for step in (*range(30), *range(30, 10, -1))]
    assert back_from(*there_and_back) == pytest.approx((23 * STEP, 0.0, 0.0))
    assert back_from(*(STEP * step for step in range(9))) == (0.0, 0.0, 0.0)
    assert back_from(0.0, 0.4) is None
    assert back_from() is None


def test_trail_before_a_pose_correction_is_forgotten() -> None:
    assert back_from(*(STEP * step for step in range(30)), 7.0, 7.3) is None
