"""Which records of a recording are due, and which are skipped."""

from cairn import SECOND
from cairn.components.replay_devices.pacing import PacedRecords

TIMES = [k * SECOND for k in range(1, 11)]


def test_records_from_before_a_late_start_are_skipped() -> None:
    records = PacedRecords(TIMES)

    assert records.due(4 * SECOND + SECOND // 4) == (range(3, 4), 3)


def test_no_record_is_skipped_when_a_running_replay_is_held_up() -> None:
    records = PacedRecords(TIMES)
    assert records.due(SECOND) == (range(1), 0)

    assert records.due(5 * SECOND) == (range(1, 5), 0)
    assert records.due(10 * SECOND) == (range(5, 10), 0)


def test_no_record_is_skipped_before_time_has_started() -> None:
    records = PacedRecords([0, SECOND])

    assert records.due(0) == (range(1), 0)


def test_records_outside_the_part_are_left_out() -> None:
    records = PacedRecords(TIMES, begin=3 * SECOND, end=5 * SECOND)

    assert records.due(2 * SECOND) == (range(2, 2), 0)
    assert records.due(20 * SECOND) == (range(2, 5), 0)
