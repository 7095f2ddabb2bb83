"""The limiter: speeds, accelerations and jerks are kept, and the robot always comes to rest."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cairn.components.velocity_gate.limiter import (
    AxisState,
    RampLimits,
    SpeedLimits,
    brake,
    clamp,
    ramp,
)

LIMITS = RampLimits(1.0, 1.5, 40.0)
SPEED = st.floats(-0.6, 0.6)
STEP_S = st.floats(0.0, 0.12)


@given(st.lists(st.tuples(SPEED, STEP_S), min_size=1, max_size=60))
@example([(-5e-324, 0.0625), (0.5, 0.0625)])  # whose product is zero
def test_ramp_keeps_all_limits_whatever_is_commanded(steps: list[tuple[float, float]]) -> None:
    state = AxisState()
    for target, seconds in steps:
        after = ramp(state, target, LIMITS, seconds)
        assert abs(after.velocity) <= 0.6 + 1e-9
        assert abs(after.rate) <= LIMITS.deceleration + 1e-9
        assert abs(after.velocity - state.velocity) <= LIMITS.deceleration * seconds + 1e-9
        assert abs(after.rate - state.rate) <= LIMITS.jerk * seconds + 1e-6
        if abs(after.velocity) > abs(state.velocity):
            rise = abs(after.velocity) - abs(state.velocity)
            assert rise <= LIMITS.acceleration * seconds + 1e-9
        state = after


@given(st.lists(st.tuples(SPEED, STEP_S), max_size=20), st.floats(0.001, 0.1))
def test_ramp_always_reaches_zero_without_reversing(
    steps: list[tuple[float, float]], seconds: float
) -> None:
    state = AxisState()
    for target, pause in steps:
        state = ramp(state, target, LIMITS, pause)
    side = state.velocity
    for _ in range(2000):
        state = ramp(state, 0.0, LIMITS, seconds)
        assert state.velocity * side >= -1e-9
    assert state == AxisState()


@given(st.floats(-10, 10), st.floats(-10, 10))
def test_clamped_command_keeps_its_arc(speed: float, turn: float) -> None:
    limits = SpeedLimits(0.6, 0.3, 1.5)
    forward, turned = clamp((speed, turn), limits)
    assert -0.3 - 1e-9 <= forward <= 0.6 + 1e-9
    assert abs(turned) <= 1.5 + 1e-9
    assert abs(forward * turn - turned * speed) < 1e-6


def test_emergency_without_a_deceleration_stops_at_once() -> None:
    assert brake(0.6, 0.0, None, 0.0).velocity == 0.0
    assert brake(0.6, 0.0, 2.0, 0.1).velocity == pytest.approx(0.4)
    assert brake(-0.1, 0.0, 2.0, 0.1).velocity == 0.0
