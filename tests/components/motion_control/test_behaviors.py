"""The recovery motions back off, look around and explore, by odometry alone."""

import math

import pytest

from cairn.components.motion_control.behaviors import BackOff, Explore, LookAround, MotionState
from tests.components.motion_control.world import LIMITS, Robot, World, box, drive
from tests.wording import assert_words

HALL = box(0, 0, 20, 20)
FRONT = 1.5 * math.pi


@pytest.mark.parametrize("view", [2 * math.pi, FRONT])
def test_back_off_drives_thirty_centimeters(view: float) -> None:
    record = drive(World(HALL), Robot((0, 0, 0)), BackOff(LIMITS), 20, view=view)

    assert record.states[-1] is MotionState.DONE
    assert record.poses[-1][0] == pytest.approx(-0.3, abs=0.03)
    assert abs(record.poses[-1][1]) < 0.05


def test_back_off_turns_around_where_the_ground_is_not_seen() -> None:
    record = drive(World(HALL), Robot((0, 0, 0)), BackOff(LIMITS), 20, view=FRONT)

    assert min(record.speeds) > -0.01
    assert abs(record.poses[-1][2]) > 2.8


def test_back_off_drives_backward_slowly_where_the_ground_is_seen() -> None:
    record = drive(World(HALL), Robot((0, 0, 0)), BackOff(LIMITS), 20)

    assert -0.16 < min(record.speeds) < -0.1
    assert abs(record.poses[-1][2]) < 0.05


@pytest.mark.parametrize("view", [2 * math.pi, FRONT])
def test_back_off_is_shorter_before_an_obstacle_behind(view: float) -> None:
    wall = (-0.42, -5.0, -0.42, 5.0)

    record = drive(World([*HALL, wall]), Robot((0, 0, 0)), BackOff(LIMITS), 20, view=view)

    assert record.states[-1] is MotionState.DONE
    assert "back: " in record.results[-1].reason
    assert record.clearance > 0.03


def test_back_off_does_not_hit_a_wall() -> None:
    wall = (-0.28, -5.0, -0.28, 5.0)

    record = drive(World([*HALL, wall]), Robot((0, 0, 0)), BackOff(LIMITS), 5)

    assert record.states[-1] is MotionState.BLOCKED
    assert "behind" in record.results[-1].reason
    assert record.clearance > 0.03


def test_look_around_turns_once() -> None:
    record = drive(World(HALL), Robot((0, 0, 0.5)), LookAround(LIMITS), 20)

    assert record.states[-1] is MotionState.DONE
    assert sum(record.turns) * 0.02 == pytest.approx(2 * math.pi, abs=0.1)
    assert max(record.turns) == pytest.approx(0.8, abs=0.01)
    assert 7.5 < record.times[-1] < 9.5


def test_explore_drives_toward_the_most_room() -> None:
    walls = [(-1.0, -1.0, 4.0, -1.0), (-1.0, 1.0, 4.0, 1.0), (-1.0, -1.0, -1.0, 1.0)]

    record = drive(World(walls + HALL), Robot((0, 0, 2.0)), Explore(LIMITS, 2.0), 30)

    assert record.states[-1] is MotionState.DONE
    assert record.poses[-1][0] > 1.7
    assert record.clearance > 0.05


def test_explore_looks_behind_for_room() -> None:
    record = drive(World(HALL), Robot((-9.7, 0, 3.1)), Explore(LIMITS, 2.0), 30, view=math.pi)

    assert record.states[-1] is MotionState.DONE
    assert record.poses[-1][0] > -8.0
    assert record.clearance > 0.0


def test_explore_reports_that_there_is_no_room() -> None:
    record = drive(
        World(box(0, 0, 0.9, 0.9)), Robot((0, 0, 0)), Explore(LIMITS, 2.0), 60, until=None
    )

    assert record.states[-1] is MotionState.BLOCKED
    assert_words(record.results[-1].reason, "no room", "0.6 m")
    assert record.clearance > 0.1
