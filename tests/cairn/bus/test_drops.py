"""Messages that wait: the newest are kept, and none waits without a wake-up."""

import queue
import sys
import threading
from collections.abc import Iterator

import pytest

from cairn.bus.drops import DropOldestQueue
from tests.patience import LIMIT_S

_MESSAGES = 100_000


@pytest.fixture
def threads_taking_turns_often() -> Iterator[None]:
    """So that every place where one thread may be overtaken by another is met."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def test_the_newest_wait_in_order() -> None:
    waiting: DropOldestQueue[int] = DropOldestQueue(3)
    assert [waiting.put(number) for number in range(5)] == [True, True, True, False, False]
    assert waiting.dropped == 2
    assert [waiting.take() for _ in range(4)] == [2, 3, 4, None]


def test_what_is_cleared_is_gone() -> None:
    waiting: DropOldestQueue[int] = DropOldestQueue(2)
    waiting.put(1)
    waiting.clear()
    assert waiting.take() is None
    assert waiting.put(2)


@pytest.mark.parametrize("depth", [1, 2, 5])
@pytest.mark.usefixtures("threads_taking_turns_often")
def test_a_reader_that_takes_one_at_each_wake_up_gets_the_last(depth: int) -> None:
    """A clock of depth 1 stood still in a process for good when a wake-up was lost."""
    waiting: DropOldestQueue[int] = DropOldestQueue(depth)
    wake_ups: queue.SimpleQueue[bool] = queue.SimpleQueue()
    taken = [-1]

    def read() -> None:
        while wake_ups.get(timeout=LIMIT_S):
            message = waiting.take()
            if message is not None:
                taken.append(message)

    reader = threading.Thread(target=read)
    reader.start()
    for number in range(_MESSAGES):
        if waiting.put(number):
            wake_ups.put(True)
    wake_ups.put(False)
    reader.join(LIMIT_S)
    assert taken[-1] == _MESSAGES - 1, f"the last message taken was {taken[-1]}"
    assert taken == sorted(taken)
    assert len(taken) - 1 + waiting.dropped == _MESSAGES
