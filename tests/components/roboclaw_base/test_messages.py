"""Diagnostics of the controller: which of several problems is reported first."""

from typing import Any

import pytest

from cairn.components.roboclaw_base.client import PacketCounts
from cairn.components.roboclaw_base.health import ControllerHealth, RetryShare
from cairn.components.roboclaw_base.messages import diagnostics_message
from cairn.components.roboclaw_base.protocol import ControllerStatus
from cairn.driver.diagnostics import ERROR, OK, WARN
from tests.wording import assert_words


def connected(**values: Any) -> ControllerHealth:
    return ControllerHealth(device_error=None, **values)


def judged(
    health: ControllerHealth, retry_share: float = 0.0, rate: float = 50.0
) -> tuple[int, str]:
    message = diagnostics_message(0, "base", "/dev/ttyACM0", health, retry_share, rate, 50.0)
    status = message.status[0]
    return status.level, status.message


@pytest.mark.parametrize(
    ("health", "level", "words"),
    [
        (connected(), OK, "drives"),
        (ControllerHealth(device_error="it is gone"), ERROR, "it is gone"),
        (
            ControllerHealth(device_error=None, wheel_fault="the left wheel runs away"),
            ERROR,
            "off until the driver is",
        ),
        (
            ControllerHealth(
                device_error=None, status=ControllerStatus(errors=("emergency stop",))
            ),
            ERROR,
            "emergency stop",
        ),
        (
            ControllerHealth(
                device_error=None, status=ControllerStatus(warnings=("hot (sensor 1)",))
            ),
            WARN,
            "hot",
        ),
        (
            ControllerHealth(device_error=None, awaits_rest=True),
            WARN,
            "until the command has been rest",
        ),
    ],
)
def test_problem_is_reported(health: ControllerHealth, level: int, words: str) -> None:
    assert judged(health)[0] == level
    assert words in judged(health)[1]


def test_slow_odometry_and_a_bad_line_are_reported() -> None:
    level, message = judged(connected(), rate=35.0)
    assert level == WARN
    assert_words(message, "odometry", "35.0 Hz", "50 Hz")
    assert "check cable" in judged(connected(), retry_share=0.1)[1]


def test_retry_share_follows_the_line_after_days_of_uptime() -> None:
    share, counts = RetryShare(), PacketCounts(packets=10_000_000)
    assert share.since_last(counts) == 0.0

    counts.packets += 100
    counts.retries += 30
    assert share.since_last(counts) == pytest.approx(0.3)

    counts.packets += 100
    assert share.since_last(counts) == 0.0
    assert share.since_last(counts) == 0.0, "no packet was sent since"
