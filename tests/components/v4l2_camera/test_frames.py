"""Capture times, and sequence numbers that show lost frames."""

import pytest

from cairn.components.v4l2_camera.frames import SequenceCounter, is_plausible

LAST = 2**32 - 1
SECOND = 1_000_000_000


def test_times_of_another_clock_are_implausible() -> None:
    now = 10**15

    assert is_plausible(now, now)
    assert is_plausible(now - 50 * SECOND, now)  # the process was stopped, or the computer asleep
    assert is_plausible(now + SECOND // 30, now)  # reckoned ahead
    assert not is_plausible(0, now)
    assert not is_plausible(now + 10 * SECOND, now)


@pytest.mark.parametrize("first", [0, 1000, LAST - 5, LAST])
def test_gaps_in_sequence_numbers_count_as_lost_frames_across_the_wrap(first: int) -> None:
    sequence = SequenceCounter()
    assert sequence.lost_before(first) == 0
    number = first
    for step in (1, 1, 2, 5, 1, 1000, 3, 1):
        number = (number + step) % 2**32
        assert sequence.lost_before(number) == step - 1


def test_restarted_or_constant_sequence_numbers_count_no_lost_frames() -> None:
    sequence = SequenceCounter()

    assert [sequence.lost_before(number) for number in (500, 0, 1, 1, 1)] == [0, 0, 0, 0, 0]
