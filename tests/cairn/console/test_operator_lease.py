"""Who steers a robot, and when a robot that is driven by hand stops."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from cairn import SECOND, CairnError
from cairn.console.operator_lease import ANSWER_S, Operator, OperatorLeases
from cairn.console.teleoperation import END_AFTER_NS, LATEST_NS, STOP_AFTER_NS, DeadMan, Driver
from tests.cairn.bus.network import eventually
from tests.patience import LIMIT_S
from tests.wording import words_in_order

ADA, BOB, EVE = Operator(1, "Ada"), Operator(2, "Bob"), Operator(3, "Eve")
AHEAD = (0.3, 0.1)
STILL = (0.0, 0.0)


@pytest.fixture
def time() -> list[float]:
    return [0.0]


@pytest.fixture
def leases(time: list[float]) -> OperatorLeases:
    return OperatorLeases(lambda: time[0])


def test_one_operator_steers_and_the_error_names_who(leases: OperatorLeases) -> None:
    leases.acquire("robot", ADA)
    leases.acquire("other", BOB)

    with pytest.raises(CairnError, match=words_in_order("robot", "Ada", "ask_lease")):
        leases.acquire("robot", BOB)
    with pytest.raises(CairnError, match=words_in_order("robot", "Ada", "ask")):
        leases.require("robot", BOB.id)
    leases.require("robot", ADA.id)
    leases.require("other", BOB.id)


def test_holder_gives_the_lease_to_the_one_who_asks_or_keeps_it(leases: OperatorLeases) -> None:
    leases.acquire("robot", ADA)

    assert not leases.ask("robot", BOB)
    assert leases.state("robot", ADA.id)["asked_by"] == "Bob"
    with pytest.raises(CairnError, match=words_in_order("Bob", "asked", "Ada")):
        leases.ask("robot", EVE)
    with pytest.raises(CairnError, match="only the operator who holds"):
        leases.answer("robot", EVE.id, grant=True)
    leases.answer("robot", ADA.id, grant=False)
    assert leases.holds("robot", ADA.id)
    leases.ask("robot", BOB)
    leases.answer("robot", ADA.id, grant=True)

    assert leases.state("robot", BOB.id) == {
        "robot": "robot", "holder": "Bob", "mine": True, "asked_by": "", "asked_by_me": False,
    }  # fmt: skip


def test_browser_that_is_gone_loses_its_leases_to_those_who_asked(leases: OperatorLeases) -> None:
    leases.acquire("robot", ADA)
    leases.acquire("other", ADA)
    leases.ask("robot", BOB)

    assert leases.leave(ADA.id) == ["robot", "other"]

    assert leases.holds("robot", BOB.id)
    assert leases.state("other", BOB.id)["holder"] == ""


def test_request_that_is_not_answered_in_time_is_granted(
    leases: OperatorLeases, time: list[float]
) -> None:
    leases.acquire("robot", ADA)
    leases.ask("robot", BOB)

    time[0] = ANSWER_S - 0.1
    assert leases.expire() == []
    time[0] = ANSWER_S
    assert leases.expire() == ["robot"]
    assert leases.holds("robot", BOB.id)


def test_robot_stops_once_when_commands_cease() -> None:
    dead_man = DeadMan(0)
    assert not dead_man.command(0, None, AHEAD)
    assert dead_man.take(0) is None  # the first command only announces others

    dead_man.command(SECOND // 10, dead_man.stamp(0), AHEAD)
    sent_at = SECOND // 10
    assert dead_man.take(sent_at) == AHEAD
    assert dead_man.take(sent_at) is None
    assert dead_man.wait_ns(sent_at) == STOP_AFTER_NS

    assert dead_man.take(sent_at + STOP_AFTER_NS) == STILL
    assert dead_man.take(sent_at + STOP_AFTER_NS) is None
    assert not dead_man.is_over(sent_at + END_AFTER_NS - 1)
    assert dead_man.is_over(sent_at + END_AFTER_NS)


def test_command_that_was_held_up_on_the_way_does_not_move_the_robot() -> None:
    dead_man = DeadMan(0)
    stamp = dead_man.stamp(0)
    late = LATEST_NS + 1

    assert not dead_man.command(late, stamp, AHEAD)
    assert dead_man.take(late) is None
    assert not dead_man.command(late, stamp + 2 * SECOND, AHEAD)  # forged
    assert dead_man.command(late, dead_man.stamp(late), AHEAD)
    assert dead_man.take(late) == AHEAD


class Gate:
    """A velocity gate with one lease, which keeps what it is sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[float, float]] = []
        self.free = threading.Semaphore()

    @contextmanager
    def acquire(self) -> Iterator[Gate]:
        if not self.free.acquire(blocking=False):
            raise CairnError("the operator's lease is held by Ada")
        try:
            yield self
        finally:
            self.sent.append((0.0, -1.0))  # marks the release
            self.free.release()

    def __call__(self, speed: float, turn: float = 0.0) -> None:
        self.sent.append((speed, turn))


def test_end_of_driving_stops_the_robot_before_the_lease_is_released() -> None:
    gate = Gate()
    driver = Driver(ADA.id, gate.acquire, now=lambda: 0)  # commands never cease
    driver.wait(LIMIT_S)
    stamp = driver.command(None, STILL)

    driver.command(stamp, AHEAD)
    assert eventually(lambda: AHEAD in gate.sent)
    driver.end()
    driver.join(LIMIT_S)

    assert gate.sent[-2:] == [STILL, (0.0, -1.0)]
    assert driver.is_over


def test_next_operator_drives_when_the_one_before_has_released_the_gate() -> None:
    gate = Gate()
    first = Driver(ADA.id, gate.acquire, now=lambda: 0)  # commands never cease
    first.wait(LIMIT_S)

    refused = Driver(BOB.id, gate.acquire)
    with pytest.raises(CairnError, match="held by Ada"):
        refused.wait(LIMIT_S)
    first.end()
    second = Driver(BOB.id, gate.acquire, first)

    second.wait(LIMIT_S)
    assert first.is_over
    second.end()
    second.join(LIMIT_S)
