"""The odometry history: interpolation, any order of arrival, jumps, and time that goes back."""

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn import SECOND
from cairn.planar.odometry import (
    ODOMETRY_DISORDER_S,
    OUTDATED_IN_A_ROW,
    OdometryChange,
    OdometryHistory,
    WheelLimits,
    is_jump,
)
from cairn.planar.poses import Pose, relative

WHEELS = WheelLimits(2.0, 4.0)
PERIOD = SECOND // 50
BEGIN = 5000 * SECOND


def test_history_interpolates_between_messages_and_does_not_extrapolate() -> None:
    history = OdometryHistory[int](1_000)
    for stamp, x in ((100, 0.0), (200, 1.0), (300, 3.0)):
        assert history.add(stamp, (x, 0.0, 0.0)) is OdometryChange.CONTINUED

    assert history.at(50) is None
    assert history.at(150) == (0.5, 0.0, 0.0)
    assert history.at(999) == (3.0, 0.0, 0.0)
    assert history.carried((10.0, 10.0, math.pi / 2), 150, 250) == pytest.approx(
        (10.0, 11.5, math.pi / 2)
    )


def test_history_knows_the_times_of_its_poses() -> None:
    history = OdometryHistory[int](1_000)
    for stamp in (100, 300, 200):
        history.add(stamp, (0.0, 0.0, 0.0))
    assert [history.has(stamp) for stamp in (50, 100, 150, 200, 300, 400)] == [
        False, True, False, True, True, False,
    ]  # fmt: skip


def test_history_forgets_poses_older_than_its_horizon() -> None:
    history = OdometryHistory[int](1_000)
    for stamp in range(0, 5_000, 100):
        history.add(stamp, (stamp / 100, 0.0, 0.0))

    assert history.at(1_000) is None
    assert history.at(4_500) == (45.0, 0.0, 0.0)


def drive(count: int, jump_at: int | None = None) -> list[tuple[int, Pose]]:
    """Odometry at 50 Hz of a robot that drives in a bend; from `jump_at` on it is elsewhere."""
    records = []
    for k in range(count):
        x, y, heading = 0.012 * k, 0.004 * math.sin(0.3 * k), 0.02 * k
        moved = 3.0 if jump_at is not None and k >= jump_at else 0.0
        records.append((BEGIN + k * PERIOD, (x + moved, y, heading)))
    return records


def history_of(records: list[tuple[int, Pose]]) -> OdometryHistory[int]:
    history = OdometryHistory[int](5 * SECOND, WHEELS)
    for stamp, pose in records:
        history.add(stamp, pose)
    return history


def answers(history: OdometryHistory[int], count: int) -> list[Any]:
    """What a history returns at the times of `count` records and between them."""
    times = [BEGIN + k * PERIOD // 2 for k in range(-1, 2 * count + 2)]
    return [history.newest, history.restarted, [history.at(time) for time in times]]


@st.composite
def arrivals(draw: st.DrawFn) -> list[tuple[int, Pose]]:
    """A drive, perhaps with a jump; each record is delayed by up to the allowed disorder.

    Before the first record after the jump at least one before it arrives.
    """
    records = drive(60, draw(st.one_of(st.none(), st.integers(27, 59))))
    most = round(ODOMETRY_DISORDER_S * SECOND)
    delays = draw(st.lists(st.integers(0, most), min_size=60, max_size=60))
    by_arrival = sorted(zip(records, delays, strict=True), key=lambda one: one[0][0] + one[1])
    return [record for record, _ in by_arrival]


@given(arrivals())
def test_any_order_of_arrival_gives_the_same_history(arrived: list[tuple[int, Pose]]) -> None:
    in_order, late = history_of(sorted(arrived)), history_of(arrived)

    assert answers(late, len(arrived)) == answers(in_order, len(arrived))
    for k in range(2 * len(arrived)):
        time = BEGIN + k * PERIOD // 2
        assert late.driven_at(time) == pytest.approx(in_order.driven_at(time), abs=1e-9)


@given(arrivals())
def test_disorder_is_never_a_reset_and_a_jump_is_reported_once(
    arrived: list[tuple[int, Pose]],
) -> None:
    jumps = sum(after[1][0] - before[1][0] > 1 for before, after in pairwise(sorted(arrived)))
    history = OdometryHistory[int](5 * SECOND, WHEELS)

    changes = [history.add(stamp, pose) for stamp, pose in arrived]

    assert set(changes) <= {
        OdometryChange.CONTINUED,
        OdometryChange.LATE,
        OdometryChange.JUMPED,
    }
    assert changes.count(OdometryChange.JUMPED) == jumps


def test_late_pose_is_inserted_at_its_place() -> None:
    history = OdometryHistory[int](SECOND)
    history.add(10 * SECOND, (0.0, 0.0, 0.0))
    history.add(10 * SECOND + 2 * PERIOD, (0.2, 0.0, 0.0))

    assert history.add(10 * SECOND + PERIOD, (0.0, 0.0, 0.0)) is OdometryChange.LATE

    assert history.newest == 10 * SECOND + 2 * PERIOD
    assert history.at(10 * SECOND + 3 * PERIOD // 2) == pytest.approx((0.1, 0.0, 0.0))


def test_late_poses_before_and_after_a_jump_stay_in_their_frames() -> None:
    records = drive(20, jump_at=10)
    first, others = records[12], [records[11], records[9], records[10], records[8]]
    history = history_of(records[:8])

    assert history.add(*first) is OdometryChange.JUMPED
    assert [history.add(*late) for late in others] == [OdometryChange.LATE] * 4

    assert history.restarted == records[10][0]
    assert history.at(records[9][0]) is None
    assert history.at(records[10][0]) == pytest.approx(records[10][1])
    # Without the jump and the step in which it occurred.
    driven = history.driven_at(records[12][0])[0] - history.driven_at(records[0][0])[0]
    assert driven == pytest.approx(0.012 * 11, abs=0.005)


@pytest.mark.parametrize("restarted_too", [False, True])
def test_way_without_jumps_continues_when_time_is_set_back(restarted_too: bool) -> None:
    history = OdometryHistory[int](5 * SECOND, WHEELS)
    history.add(BEGIN, (4.0, -3.0, 2.0))
    assert history.add(BEGIN + PERIOD, (0.0, 0.0, 0.0)) is OdometryChange.JUMPED
    history.add(BEGIN + 2 * PERIOD, (0.02, 0.0, 0.0))
    before = history.driven_at(BEGIN + 2 * PERIOD)

    after: Pose = (7.0, 0.0, 0.0) if restarted_too else (0.04, 0.0, 0.0)
    assert history.add(BEGIN - 60 * SECOND, after) is OdometryChange.RESET

    moved = 0.0 if restarted_too else 0.02
    way = history.driven_at(BEGIN - 60 * SECOND)
    assert relative(before, way) == pytest.approx((moved, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("back", [SECOND * 6 // 10, 3600 * SECOND])
def test_history_restarts_once_when_time_goes_back(back: int) -> None:
    history = OdometryHistory[int](SECOND)
    for k in range(10):
        history.add(BEGIN + k * PERIOD, (0.01 * k, 0.0, 0.0))
    newest = BEGIN + 9 * PERIOD

    message = [history.add(newest - back + k * PERIOD, (1.0 + k, 0.0, 0.0)) for k in range(3)]

    assert message == [OdometryChange.RESET, OdometryChange.CONTINUED, OdometryChange.CONTINUED]
    assert history.at(newest - back - 1) is None
    assert history.at(newest - back + PERIOD) == (2.0, 0.0, 0.0)
    assert history.newest == newest - back + 2 * PERIOD


def test_history_restarts_when_time_goes_back_a_little_and_poses_contradict() -> None:
    records = drive(50)
    history = history_of(records)
    back = records[-1][0] - SECOND // 5

    changes = [history.add(back + k * PERIOD, (7.0, 7.0, 0.0)) for k in range(OUTDATED_IN_A_ROW)]

    assert changes == [OdometryChange.OUTDATED] * (OUTDATED_IN_A_ROW - 1) + [OdometryChange.RESET]
    assert history.at(records[-1][0]) == (7.0, 7.0, 0.0)


def test_single_late_pose_that_contradicts_its_neighbors_is_ignored() -> None:
    records = drive(50)
    history = history_of(records)
    before = answers(history, 50)

    assert history.add(records[45][0] + 1, (7.0, 7.0, 0.0)) is OdometryChange.OUTDATED

    assert answers(history, 50) == before


def test_stragglers_do_not_reset_a_history_that_asks_for_several() -> None:
    records = drive(50)
    history = OdometryHistory[int](5 * SECOND, WHEELS, resets_after=3)
    for record in records:
        history.add(*record)

    old = records[-1][0] - SECOND
    assert history.add(old, (0.0, 0.0, 0.0)) is OdometryChange.OUTDATED
    assert history.add(records[-1][0] + PERIOD, records[-1][1]) is OdometryChange.CONTINUED
    changes = [history.add(old + k * PERIOD, (0.0, 0.0, 0.0)) for k in range(3)]

    assert changes == [OdometryChange.OUTDATED, OdometryChange.OUTDATED, OdometryChange.RESET]


@pytest.mark.parametrize(
    ("step", "seconds", "jump"),
    [
        ((0.1, 0.0, 0.2), 0.05, False),
        ((0.3, 0.0, 0.0), 0.05, True),
        ((0.0, 0.0, 1.0), 0.05, True),
        ((0.0, 0.0, 2 * math.pi), 0.05, False),
        ((1.0, 0.0, 0.0), 0.5, False),
        ((2.0, 0.0, 0.0), 3.0, True),  # a driver that restarted after a silence
    ],
)
def test_step_that_is_impossible_for_wheels_is_a_jump(
    step: tuple[float, float, float], seconds: float, jump: bool
) -> None:
    assert is_jump((0.0, 0.0, 0.0), step, seconds, 2.0, 4.0) is jump
