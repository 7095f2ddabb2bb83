"""Wheels that do not follow commands are detected; others are not."""

import re

import pytest

from cairn.components.roboclaw_base.kinematics import Pair
from cairn.components.roboclaw_base.wheel_faults import WheelFaultDetector, WheelFaultLimits

PERIOD = 0.02


def detected(commanded: Pair, measured: Pair, seconds: float) -> str | None:
    detector = WheelFaultDetector(WheelFaultLimits(speed=0.05, blocked_s=0.8, runaway_s=0.3))
    for cycle in range(round(seconds / PERIOD)):
        fault = detector.check(cycle * PERIOD, commanded, measured)
        if fault is not None:
            return fault
    return None


def test_wheels_that_follow_have_no_fault() -> None:
    assert detected((0.3, -0.3), (0.25, -0.33), 60.0) is None
    assert detected((0.0, 0.0), (0.02, -0.05), 60.0) is None


@pytest.mark.parametrize(
    ("commanded", "measured", "found"),
    [
        ((0.3, 0.3), (0.3, 0.0), "the right wheel .* its encoder stands still"),
        ((-0.3, -0.3), (0.2, -0.3), "the left wheel .* it counts against its motor"),
        ((0.1, 0.1), (0.1, 0.6), "the right wheel .* runs away"),
        ((0.0, 0.0), (0.5, 0.0), "the left wheel .* runs away"),
    ],
)
def test_faulty_wheel_is_named(commanded: Pair, measured: Pair, found: str) -> None:
    fault = detected(commanded, measured, 1.0)

    assert fault is not None
    assert re.search(found, fault), fault


def test_short_deviation_does_not_count_as_a_fault() -> None:
    assert detected((0.3, 0.3), (0.3, 0.0), 0.7) is None
    assert detected((0.3, 0.3), (0.3, -0.2), 0.25) is None


def test_interrupted_symptom_starts_again() -> None:
    detector = WheelFaultDetector(WheelFaultLimits(speed=0.05, blocked_s=0.8, runaway_s=0.3))
    for cycle in range(300):
        measured = 0.3 if cycle % 30 == 0 else 0.0
        assert detector.check(cycle * PERIOD, (0.3, 0.3), (measured, 0.3)) is None


def test_wheel_commanded_below_the_fault_speed_may_stand() -> None:
    assert detected((0.04, 0.04), (0.0, 0.0), 60.0) is None
