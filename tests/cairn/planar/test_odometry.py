"""The odometry history: interpolation, late messages, jumps, and time that goes back."""

import math

import pytest

from cairn import SECOND
from cairn.planar.odometry import OdometryChange, OdometryHistory, is_jump


def test_history_interpolates_between_messages_and_does_not_extrapolate() -> None:
    history = OdometryHistory(1_000)
    for stamp, x in ((100, 0.0), (200, 1.0), (300, 3.0)):
        assert history.add(stamp, (x, 0.0, 0.0)) is OdometryChange.CONTINUED

    assert history.at(50) is None
    assert history.at(150) == (0.5, 0.0, 0.0)
    assert history.at(999) == (3.0, 0.0, 0.0)
    assert history.carried((10.0, 10.0, math.pi / 2), 150, 250) == pytest.approx(
        (10.0, 11.5, math.pi / 2)
    )


def test_history_forgets_poses_older_than_its_horizon() -> None:
    history = OdometryHistory(1_000)
    for stamp in range(0, 5_000, 100):
        history.add(stamp, (stamp / 100, 0.0, 0.0))

    assert history.at(1_000) is None
    assert history.at(4_500) == (45.0, 0.0, 0.0)


def test_pose_slightly_older_than_the_newest_is_ignored() -> None:
    history = OdometryHistory(SECOND)
    history.add(10 * SECOND, (1.0, 0.0, 0.0))

    assert history.add(10 * SECOND - SECOND // 20, (9.0, 9.0, 9.0)) is OdometryChange.OUTDATED

    assert history.newest == 10 * SECOND
    assert history.at(11 * SECOND) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("back", [SECOND // 5, 3600 * SECOND])
def test_history_restarts_once_when_time_goes_back(back: int) -> None:
    history = OdometryHistory(SECOND)
    for k in range(10):
        history.add(5000 * SECOND + k * SECOND // 50, (0.01 * k, 0.0, 0.0))
    newest = 5000 * SECOND + 9 * SECOND // 50

    message = [history.add(newest - back + k * SECOND // 50, (1.0 + k, 0.0, 0.0)) for k in range(3)]

    assert message == [OdometryChange.RESET, OdometryChange.CONTINUED, OdometryChange.CONTINUED]
    assert history.at(newest - back - 1) is None
    assert history.at(newest - back + SECOND // 50) == (2.0, 0.0, 0.0)
    assert history.newest == newest - back + SECOND // 25


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
