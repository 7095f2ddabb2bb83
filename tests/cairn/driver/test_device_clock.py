"""A device's clock is followed through wraps, drift, late messages and being set."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.driver.device_clock import DeviceClock

_MODULUS = 1 << 24


@given(st.integers(0, _MODULUS - 1), st.lists(st.integers(0, _MODULUS // 2), max_size=50))
def test_it_counts_on_beyond_wraps(begin: int, steps: list[int]) -> None:
    clock = DeviceClock(1000, 24)
    truth, shown = [begin], begin
    for step in steps:
        shown += step
        truth.append(shown)

    seconds = [clock.seconds(ticks % _MODULUS) for ticks in truth]

    for (before, after), step in zip(pairwise(seconds), steps, strict=True):
        assert after - before == pytest.approx(step / 1000, abs=1e-6)


def test_one_damaged_time_does_not_count_as_a_wrap() -> None:
    clock = DeviceClock(1000, 24)
    begin = clock.seconds(1000)
    clock.seconds(900)  # an older one
    clock.seconds(_MODULUS - 5)  # nonsense

    assert clock.seconds(1025) - begin == pytest.approx(0.025)


def test_the_least_way_is_found_and_late_messages_do_not_matter() -> None:
    clock = DeviceClock(1000, 24)
    offsets = [
        clock.offset(t, 100.0 + t + late)
        for t, late in [(0.0, 0.03), (0.1, 0.01), (0.2, 0.5), (0.3, 2.0), (0.4, 0.01)]
    ]

    assert offsets[0] == pytest.approx(100.03)
    assert offsets[1:] == pytest.approx([100.01] * 4, abs=0.002)
    assert clock.jumps == 0


@pytest.mark.parametrize("drift", [300e-6, -300e-6])
def test_clocks_that_drift_are_followed(drift: float) -> None:
    clock = DeviceClock(1000, 24)
    for number in range(10_000):
        arrived = 0.1 * number
        found = clock.offset(arrived * (1.0 + drift), arrived + 0.002)

    assert found == pytest.approx(0.002 - drift * arrived, abs=0.001)
    assert clock.jumps == 0


def test_a_clock_that_was_set_forward_is_followed_soon() -> None:
    clock = DeviceClock(1000, 24)
    clock.offset(0.0, 100.0)
    found = [clock.offset(500.0 + 0.1 * number, 100.1 + 0.1 * number) for number in range(4)]

    assert found[0] == pytest.approx(100.0, abs=0.001)  # it may be damaged
    assert found[-1] == pytest.approx(-399.9, abs=0.001)
    assert clock.jumps == 1


def test_a_clock_that_was_set_back_is_followed_in_the_end() -> None:
    clock = DeviceClock(1000, 24)
    clock.offset(1000.0, 2000.0)
    found = [clock.offset(0.1 * number, 2000.1 + 0.1 * number) for number in range(40)]

    assert found[0] == pytest.approx(1000.0, abs=0.001)  # it may be late
    assert found[-1] == pytest.approx(2000.1, abs=0.001)
    assert clock.jumps == 1


def test_another_device_begins_anew() -> None:
    clock = DeviceClock(1000, 24)
    clock.offset(clock.seconds(5000), 100.0)
    clock.restart()

    assert clock.seconds(10) == pytest.approx(0.01)
    assert clock.offset(0.01, 200.0) == pytest.approx(199.99)
