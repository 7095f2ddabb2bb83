"""The drop-oldest queue keeps the newest messages, and none is pending without a wake-up."""

import queue
import sys
import threading
from collections.abc import Iterator

import pytest

from cairn.bus.drop_oldest_queue import DropOldestQueue, LossCounter
from tests.patience import LIMIT_S

_MESSAGES = 100_000


@pytest.fixture
def frequent_thread_switches() -> Iterator[None]:
    """Switch threads so often that every possible interleaving occurs."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def test_newest_messages_are_kept_in_order() -> None:
    pending: DropOldestQueue[int] = DropOldestQueue(3, 100)
    assert [pending.put(number, 0) for number in range(5)] == [True, True, True, False, False]
    assert pending.dropped == 2
    assert [pending.take() for _ in range(4)] == [2, 3, 4, None]


def test_clear_discards_the_messages() -> None:
    pending: DropOldestQueue[int] = DropOldestQueue(2, 100)
    pending.put(1, 100)
    pending.clear()
    assert pending.take() is None
    assert pending.put(2, 100)


def test_messages_that_are_together_too_long_displace_the_oldest() -> None:
    pending: DropOldestQueue[str] = DropOldestQueue(10, max_bytes=100)

    assert [pending.put(*sized) for sized in (("a", 40), ("b", 40), ("c", 20))] == [True] * 3
    assert not pending.put("d", 50)  # instead of two

    assert pending.dropped == 2
    assert [pending.take() for _ in range(3)] == ["c", "d", None]
    assert pending.put("longer than the limit", 1_000)
    assert not pending.put("e", 1)
    assert [pending.take(), pending.take(), pending.dropped] == ["e", None, 3]
    assert pending.put("f", 100)


@pytest.mark.parametrize("depth", [1, 2, 5])
@pytest.mark.usefixtures("frequent_thread_switches")
def test_subscriber_that_takes_one_message_per_wake_up_gets_the_last(depth: int) -> None:
    """Before, a clock topic of depth 1 stalled for good when a wake-up was lost."""
    pending: DropOldestQueue[int] = DropOldestQueue(depth, 100)
    wake_ups: queue.Queue[bool] = queue.Queue()
    taken = [-1]

    def read() -> None:
        while wake_ups.get(timeout=LIMIT_S):
            message = pending.take()
            if message is not None:
                taken.append(message)

    reader = threading.Thread(target=read)
    reader.start()
    for number in range(_MESSAGES):
        if pending.put(number, 0):
            wake_ups.put(True)
    wake_ups.put(False)
    reader.join(LIMIT_S)
    assert taken[-1] == _MESSAGES - 1, f"the last message taken was {taken[-1]}"
    assert taken == sorted(taken)
    assert len(taken) - 1 + pending.dropped == _MESSAGES


def test_gaps_in_a_publishers_sequence_numbers_count_as_lost() -> None:
    counter = LossCounter()
    for publisher, sequence in [(b"a", 7), (b"b", 1), (b"a", 8), (b"a", 11), (b"b", 2)]:
        counter.received(publisher, sequence)
    assert counter.lost == 2
