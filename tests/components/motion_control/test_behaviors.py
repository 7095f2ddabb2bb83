"""Backing off, looking around and exploring, by odometry alone."""

import math

import pytest

from cairn.components.motion_control.behaviors import BackOff, Explore, LookAround, State
from tests.components.motion_control.world import LIMITS, Robot, World, box, drive

HALL = box(0, 0, 20, 20)
FRONT = 1.5 * math.pi


@pytest.mark.parametrize("view", [2 * math.pi, FRONT])
def test_it_backs_off_by_thirty_centimeters(view: float) -> None:
    record = drive(World(HALL), Robot((0, 0, 0)), BackOff(LIMITS), 20, view=view)

    assert record.states[-1] is State.DONE
    assert record.poses[-1][0] == pytest.approx(-0.3, abs=0.03)
    assert abs(record.poses[-1][1]) < 0.05


def test_it_does_not_go_backwards_into_what_it_does_not_see() -> None:
    record = drive(World(HALL), Robot((0, 0, 0)), BackOff(LIMITS), 20, view=FRONT)

    assert min(record.speeds) > -0.01
    assert abs(record.poses[-1][2]) > 2.8


def test_it_goes_backwards_slowly_where_it_sees() -> None:
    record = drive(World(HALL), Robot((0, 0, 0)), BackOff(LIMITS), 20)

    assert -0.16 < min(record.speeds) < -0.1
    assert abs(record.poses[-1][2]) < 0.05


@pytest.mark.parametrize("view", [2 * math.pi, FRONT])
def test_it_backs_off_less_where_something_is_behind(view: float) -> None:
    wall = (-0.42, -5.0, -0.42, 5.0)

    record = drive(World([*HALL, wall]), Robot((0, 0, 0)), BackOff(LIMITS), 20, view=view)

    assert record.states[-1] is State.DONE
    assert "back: " in record.motions[-1].reason
    assert record.clearance > 0.03


def test_it_does_not_back_off_into_a_wall() -> None:
    wall = (-0.28, -5.0, -0.28, 5.0)

    record = drive(World([*HALL, wall]), Robot((0, 0, 0)), BackOff(LIMITS), 5)

    assert record.states[-1] is State.BLOCKED
    assert "behind" in record.motions[-1].reason
    assert record.clearance > 0.03


def test_it_turns_once_around() -> None:
    record = drive(World(HALL), Robot((0, 0, 0.5)), LookAround(LIMITS), 20)

    assert record.states[-1] is State.DONE
    assert sum(record.turns) * 0.02 == pytest.approx(2 * math.pi, abs=0.1)
    assert max(record.turns) == pytest.approx(0.8, abs=0.01)
    assert 7.5 < record.times[-1] < 9.5


def test_it_explores_towards_the_room() -> None:
    walls = [(-1.0, -1.0, 4.0, -1.0), (-1.0, 1.0, 4.0, 1.0), (-1.0, -1.0, -1.0, 1.0)]

    record = drive(World(walls + HALL), Robot((0, 0, 2.0)), Explore(LIMITS, 2.0), 30)

    assert record.states[-1] is State.DONE
    assert record.poses[-1][0] > 1.7
    assert record.clearance > 0.05


def test_it_looks_behind_for_room_that_it_does_not_see() -> None:
    record = drive(World(HALL), Robot((-9.7, 0, 3.1)), Explore(LIMITS, 2.0), 30, view=math.pi)

    assert record.states[-1] is State.DONE
    assert record.poses[-1][0] > -8.0
    assert record.clearance > 0.0


def test_it_says_that_there_is_no_room_to_explore() -> None:
    record = drive(
        World(box(0, 0, 0.9, 0.9)), Robot((0, 0, 0)), Explore(LIMITS, 2.0), 60, until=None
    )

    assert record.states[-1] is State.BLOCKED
    assert record.motions[-1].reason == "no room of 0.6 m to go to"
    assert record.clearance > 0.1
