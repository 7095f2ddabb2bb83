"""The offset between two machines' clocks: right whatever the ways of the messages take."""

from hypothesis import given
from hypothesis import strategies as st

from cairn.processes.machine_clocks import ClockOffset, ClockOffsetFilter

MS = 1_000_000
delays = st.integers(0, 200 * MS)


def exchange(
    clock: ClockOffsetFilter, at_ms: float, offset_ns: int, there_ns: int, back_ns: int
) -> None:
    """Add an exchange that ended at `at_ms`, with a clock that is ahead by `offset_ns`."""
    t4 = round(at_ms * MS) + 10_000 * MS
    t3 = t4 - back_ns + offset_ns
    t2 = t3 - 100 * MS
    t1 = t2 - offset_ns - there_ns
    clock.add(t1, t2, t3, t4, at_ms / 1000)


@given(
    offset=st.integers(-3_600_000 * MS, 3_600_000 * MS),
    ways=st.lists(st.tuples(delays, delays), min_size=1, max_size=60),
)
def test_true_offset_is_within_the_stated_error(offset: int, ways: list[tuple[int, int]]) -> None:
    clock = ClockOffsetFilter()
    for number, (there, back) in enumerate(ways):
        exchange(clock, 250.0 * number, offset, there, back)
    found = clock.estimate(0.25 * len(ways))
    assert found is not None
    assert abs(found.offset_s - offset / 1e9) <= found.error_s + 1e-6


def test_quickest_exchange_decides() -> None:
    clock = ClockOffsetFilter()
    exchange(clock, 0, 5 * MS, 40 * MS, 90 * MS)
    exchange(clock, 250, 5 * MS, 1 * MS, 1 * MS)
    exchange(clock, 500, 5 * MS, 10 * MS, 80 * MS)
    found = clock.estimate(0.5)
    assert found is not None
    assert abs(found.offset_s - 0.005) < 1e-6
    assert found.error_s < 0.0012


def test_clock_that_was_set_is_measured_anew() -> None:
    clock = ClockOffsetFilter()
    for number in range(10):
        exchange(clock, 250.0 * number, 0, MS, MS)
    exchange(clock, 2500, 700 * MS, 3 * MS, 3 * MS)
    found = clock.estimate(2.5)
    assert found is not None
    assert abs(found.offset_s - 0.7) < 0.0031


def test_exchange_across_a_step_of_the_clock_counts_for_nothing() -> None:
    clock = ClockOffsetFilter()
    clock.add(0, 100 * MS, 200 * MS, 50 * MS, 0.0)  # it ended before it began
    assert clock.estimate(0.0) is None


def test_error_grows_with_age() -> None:
    clock = ClockOffsetFilter()
    exchange(clock, 0, 0, MS, MS)
    first, later = clock.estimate(0.0), clock.estimate(100.0)
    assert first is not None
    assert later is not None
    assert later.error_s - first.error_s > 0.009


def test_clocks_differ_only_if_that_is_certain() -> None:
    assert ClockOffset(0.2, 0.01).exceeds(0.1)
    assert ClockOffset(-0.2, 0.01).exceeds(0.1)
    assert not ClockOffset(0.2, 0.15).exceeds(0.1)
    assert str(ClockOffset(-0.25, 0.002)) == "its clock is 0.25 s behind (within 0.002 s)"
