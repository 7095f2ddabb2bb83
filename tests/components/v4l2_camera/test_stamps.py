"""Times of pictures, and numbers that tell which are missing."""

import time

import pytest

from cairn.components.v4l2_camera.stamps import Sequence, is_likely, system_offset

LAST = 2**32 - 1
SECOND = 1_000_000_000


def test_the_kernels_time_becomes_the_systems() -> None:
    before = time.time_ns()
    now = time.monotonic_ns() + system_offset()
    after = time.time_ns()

    assert before - 1_000_000 <= now <= after + 1_000_000


def test_times_by_another_clock_are_noticed() -> None:
    now = 10**15

    assert is_likely(now, now)
    assert is_likely(now - 50 * SECOND, now)  # the process was stopped, or the computer asleep
    assert is_likely(now + SECOND // 30, now)  # reckoned ahead
    assert not is_likely(0, now)
    assert not is_likely(now + 10 * SECOND, now)


@pytest.mark.parametrize("first", [0, 1000, LAST - 5, LAST])
def test_numbers_left_out_are_pictures_lost_even_where_numbers_wrap(first: int) -> None:
    sequence = Sequence()
    assert sequence.lost_before(first) == 0
    number = first
    for step in (1, 1, 2, 5, 1, 1000, 3, 1):
        number = (number + step) % 2**32
        assert sequence.lost_before(number) == step - 1


def test_numbers_that_begin_anew_or_stay_are_no_loss() -> None:
    sequence = Sequence()

    assert [sequence.lost_before(number) for number in (500, 0, 1, 1, 1)] == [0, 0, 0, 0, 0]
