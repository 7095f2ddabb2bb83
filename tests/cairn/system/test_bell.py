"""A bell wakes its waiting thread, whichever thread or signal handler rings it, and in time."""

import random
import signal
import threading

from cairn.system.bell import Bell
from tests.patience import LIMIT_S


def test_ring_before_the_wait_ends_it_at_once_and_counts_once() -> None:
    bell = Bell()
    bell.ring()
    bell.ring()

    assert bell.wait(LIMIT_S)
    assert not bell.wait(0.0)


def test_ring_from_another_thread_ends_the_wait() -> None:
    bell = Bell()
    threading.Timer(0.01, bell.ring).start()

    assert bell.wait(LIMIT_S)


def test_ring_from_a_signal_handler_ends_the_wait_of_the_same_thread() -> None:
    bell = Bell()
    before = signal.signal(signal.SIGALRM, lambda *_: bell.ring())
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.01)
        assert bell.wait(LIMIT_S)
    finally:
        signal.signal(signal.SIGALRM, before)


def test_wait_that_is_over_at_once_ends() -> None:
    """With `queue.SimpleQueue` some hundred of these waits are enough for one without end."""
    bell = Bell()
    drawn = random.Random(17)
    limits = [drawn.uniform(1e-7, 3e-6) for _ in range(1000)]

    def wait() -> None:
        for _ in range(30):
            for limit_s in limits:
                bell.ring()
                bell.wait(0.0)
                bell.wait(limit_s)

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    waiting.join(LIMIT_S)
    assert not waiting.is_alive(), "a wait of at most 3 us has not ended"
