"""What the base tells of its controller: which of several things an operator is told first."""

import pytest

from cairn.components.roboclaw.dialogue import DialogueCounts
from cairn.components.roboclaw.health import Health, RetryShare
from cairn.components.roboclaw.messages import diagnostics_message
from cairn.components.roboclaw.status import Status
from cairn.driver.diagnostics import ERROR, OK, WARN


def told(health: Health, retried: float = 0.0, rate: float = 50.0) -> tuple[int, str]:
    message = diagnostics_message(0, "base", "/dev/ttyACM0", health, retried, rate, 50.0)
    status = message.status[0]
    return status.level, status.message


@pytest.mark.parametrize(
    ("health", "level", "part"),
    [
        (Health(trouble=None), OK, "drives"),
        (Health(trouble="it is gone"), ERROR, "it is gone"),
        (Health(trouble=None, fault="the left wheel runs away"), ERROR, "off until the driver is"),
        (Health(trouble=None, status=Status(errors=("emergency stop",))), ERROR, "emergency stop"),
        (Health(trouble=None, status=Status(warnings=("hot (sensor 1)",))), WARN, "hot"),
        (Health(trouble=None, awaits_rest=True), WARN, "until the command has been rest"),
    ],
)
def test_what_is_wrong_is_told(health: Health, level: int, part: str) -> None:
    assert told(health)[0] == level
    assert part in told(health)[1]


def test_slow_odometry_and_a_bad_line_are_told() -> None:
    assert told(Health(trouble=None), rate=35.0) == (
        WARN,
        "the odometry comes at 35.0 Hz instead of 50 Hz",
    )
    assert "see to cable" in told(Health(trouble=None), retried=0.1)[1]


def test_a_line_that_becomes_bad_after_days_is_noticed_at_once_and_so_is_its_end() -> None:
    share, counts = RetryShare(), DialogueCounts(packets=10_000_000)
    assert share.since_last(counts) == 0.0

    counts.packets += 100
    counts.retries += 30
    assert share.since_last(counts) == pytest.approx(0.3)

    counts.packets += 100
    assert share.since_last(counts) == 0.0
    assert share.since_last(counts) == 0.0, "nothing was sent meanwhile"
