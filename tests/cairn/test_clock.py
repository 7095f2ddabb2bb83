"""Times of components: whether a time has passed, and stamps."""

import pytest

from cairn import SECOND, from_ns, has_passed, to_ns


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
