"""Times of components: whether a time has passed, and stamps."""

import pytest

from cairn import SECOND, SteadyClock, from_ns, has_passed, to_ns
from cairn.system.clock import SimulatedClock


@pytest.mark.parametrize(
    ("passed_s", "expected"),
    [(0.0, False), (0.999, False), (1.0, True), (3600.0, True), (-1e-9, True), (-3600.0, True)],
)
def test_time_has_passed_when_it_is_over_or_the_clock_was_set_back(
    passed_s: float, expected: bool
) -> None:
    since = 1_800_000_000 * SECOND

    assert has_passed(1.0, since, since + round(passed_s * SECOND)) is expected


@pytest.mark.parametrize("time_ns", [0, 1, SECOND - 1, 1_800_000_000 * SECOND + 7, -1])
def test_stamps_keep_the_nanoseconds(time_ns: int) -> None:
    assert to_ns(from_ns(time_ns)) == time_ns


def test_steady_clock_has_no_steps() -> None:
    clock = SimulatedClock()
    clock.set(1000 * SECOND)
    steady = SteadyClock(clock, longest_s=1.0)
    read = []

    for now_s in (1000.5, 1001.5, 4602.0, 4602.5, 1003.0, 1003.25, 1003.25):
        clock.set(round(now_s * SECOND))
        read.append(steady.now() / SECOND)

    assert read == [1000.5, 1001.5, 1001.5, 1002.0, 1002.0, 1002.25, 1002.25]
