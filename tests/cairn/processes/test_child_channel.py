"""The channel between a supervisor and a child's process: bounds, garbage, unread messages."""

import json
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from cairn.processes.child_channel import (
    LONGEST_PACKET,
    ChildChannel,
    Heartbeat,
    InvalidPacket,
    Request,
    SupervisorChannel,
    TransitionAnswer,
    channel_pair,
    sendable,
)
from cairn.runtime.lifecycle import LifecycleState
from tests.patience import LIMIT_S
from tests.wording import words_in_order

ACTIVE = Heartbeat(LifecycleState.ACTIVE)


@pytest.fixture
def ends() -> Iterator[tuple[SupervisorChannel, socket.socket]]:
    own, other = channel_pair()
    with own, other:
        yield SupervisorChannel(own), other


def test_request_is_answered_and_the_newest_heartbeat_kept(
    ends: tuple[SupervisorChannel, socket.socket],
) -> None:
    supervisor, child = ends[0], ChildChannel(ends[1])
    assert supervisor.request("configure")
    assert child.receive() == Request(1, "configure")
    child.send_heartbeat(lambda: ACTIVE)
    busy = Heartbeat(LifecycleState.INACTIVE, sendable("on_request \ud800" + "x" * 9000), 2.5)
    child.send_heartbeat(lambda: busy)
    child.send_answer(TransitionAnswer(0, "of an earlier request"))
    supervisor.receive(LIMIT_S)
    assert (supervisor.heartbeat, supervisor.heartbeats, supervisor.answer) == (busy, 2, None)
    child.send_answer(TransitionAnswer(1, "no device"))
    supervisor.receive(LIMIT_S)
    assert supervisor.answer == TransitionAnswer(1, "no device")


def test_last_heartbeat_has_the_last_state(
    ends: tuple[SupervisorChannel, socket.socket],
) -> None:
    supervisor, child = ends[0], ChildChannel(ends[1])
    is_read, goes_on = threading.Event(), threading.Event()

    def before_the_transition() -> Heartbeat:
        is_read.set()
        assert goes_on.wait(LIMIT_S)
        return Heartbeat(LifecycleState.UNCONFIGURED)

    early = threading.Thread(target=child.send_heartbeat, args=(before_the_transition,))
    early.start()
    assert is_read.wait(LIMIT_S)
    late = threading.Thread(target=child.send_heartbeat, args=(lambda: ACTIVE,))
    late.start()
    late.join(0.1)  # it may wait for the other one
    goes_on.set()
    for thread in (early, late):
        thread.join(LIMIT_S)
    supervisor.receive(LIMIT_S)
    assert (supervisor.heartbeat, supervisor.heartbeats) == (ACTIVE, 2)


@pytest.mark.parametrize(
    "packet",
    [
        b"garbage",
        b"x" * (LONGEST_PACKET + 1),
        json.dumps({"kind": "request", "number": 1, "verb": "shutdown"}).encode(),
        json.dumps({"kind": "heartbeat", "state": "asleep"}).encode(),
        b'{"kind": "heartbeat", "state": "active", "handler_s": NaN}',
        b'{"kind": "heartbeat", "state": "active", "other": 1}',
    ],
)
def test_invalid_packet_is_rejected_with_the_reason(
    ends: tuple[SupervisorChannel, socket.socket], packet: bytes
) -> None:
    ends[1].send(packet)
    with pytest.raises(InvalidPacket, match=words_in_order("message")):
        ends[0].receive(LIMIT_S)


def test_neither_end_waits_for_one_that_does_not_read(
    ends: tuple[SupervisorChannel, socket.socket],
) -> None:
    supervisor, child = ends[0], ChildChannel(ends[1])
    began = time.monotonic()
    sent = sum(supervisor.request("activate") for _ in range(2000))
    for _ in range(2000):
        child.send_heartbeat(lambda: ACTIVE)
    assert 0 < sent < 2000
    assert time.monotonic() - began < LIMIT_S
    supervisor.receive(0.0)
    assert 0 < supervisor.heartbeats < 2000


def test_end_of_the_child_closes_the_channel(
    ends: tuple[SupervisorChannel, socket.socket],
) -> None:
    ChildChannel(ends[1]).send_heartbeat(lambda: ACTIVE)
    ends[1].close()
    ends[0].receive(LIMIT_S)
    assert (ends[0].heartbeat, ends[0].closed) == (ACTIVE, True)
    assert not ends[0].request("shutdown")
