"""Wheels that do not do what they are asked are found, others are left alone."""

import re

import pytest

from cairn.components.roboclaw.kinematics import Pair
from cairn.components.roboclaw.wheel_watch import WatchLimits, WheelWatch

PERIOD = 0.02


def judged(asked: Pair, seen: Pair, seconds: float) -> str | None:
    watch = WheelWatch(WatchLimits(speed=0.05, stands_s=0.8, runs_s=0.3))
    for cycle in range(round(seconds / PERIOD)):
        told = watch.judge(cycle * PERIOD, asked, seen)
        if told is not None:
            return told
    return None


def test_wheels_that_follow_are_left_alone() -> None:
    assert judged((0.3, -0.3), (0.25, -0.33), 60.0) is None
    assert judged((0.0, 0.0), (0.02, -0.05), 60.0) is None


@pytest.mark.parametrize(
    ("asked", "seen", "found"),
    [
        ((0.3, 0.3), (0.3, 0.0), "the right wheel .* its encoder stands still"),
        ((-0.3, -0.3), (0.2, -0.3), "the left wheel .* it counts against its motor"),
        ((0.1, 0.1), (0.1, 0.6), "the right wheel .* runs away"),
        ((0.0, 0.0), (0.5, 0.0), "the left wheel .* runs away"),
    ],
)
def test_a_wheel_that_does_otherwise_is_named(asked: Pair, seen: Pair, found: str) -> None:
    told = judged(asked, seen, 1.0)

    assert told is not None
    assert re.search(found, told), told


def test_a_moment_is_not_judged() -> None:
    assert judged((0.3, 0.3), (0.3, 0.0), 0.7) is None
    assert judged((0.3, 0.3), (0.3, -0.2), 0.25) is None


def test_what_was_over_meanwhile_is_counted_anew() -> None:
    watch = WheelWatch(WatchLimits(speed=0.05, stands_s=0.8, runs_s=0.3))
    for cycle in range(300):
        seen = 0.3 if cycle % 30 == 0 else 0.0
        assert watch.judge(cycle * PERIOD, (0.3, 0.3), (seen, 0.3)) is None


def test_slower_than_it_judges_a_wheel_may_stand() -> None:
    assert judged((0.04, 0.04), (0.0, 0.0), 60.0) is None
