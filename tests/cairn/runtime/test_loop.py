"""The loop makes calls one at a time, in order, from any thread, and ends cleanly."""

import threading
import time
import weakref
from collections.abc import Iterator

import pytest

from cairn.runtime.loop import ThreadLoop
from cairn.system.clock import SystemClock
from tests.patience import LIMIT_S


class Running:
    """A loop on a thread of its own."""

    def __init__(self) -> None:
        self.loop = ThreadLoop()
        self.failure: list[Exception] = []
        self.thread = threading.Thread(target=self._run)

    def start(self) -> None:
        self.thread.start()

    def join(self) -> None:
        self.thread.join(LIMIT_S)
        assert not self.thread.is_alive()

    def _run(self) -> None:
        try:
            self.loop.run()
        except RuntimeError as error:
            self.failure.append(error)


@pytest.fixture
def running() -> Iterator[Running]:
    running = Running()
    yield running
    if running.thread.is_alive():
        running.loop.post(running.loop.stop)
        running.join()


def test_calls_are_made_in_order_of_arrival(running: Running) -> None:
    made: list[int] = []
    for number in range(100):
        running.loop.post(lambda number=number: made.append(number))  # type: ignore[misc]
    running.loop.post(running.loop.stop)
    running.start()
    running.join()

    assert made == list(range(100))


def test_delivering_thread_makes_the_call_if_the_loop_is_idle(running: Running) -> None:
    made_by: list[int] = []
    running.loop.deliver(lambda: made_by.append(threading.get_ident()))

    assert made_by == [threading.get_ident()]


def test_calls_from_many_threads_never_overlap_and_none_is_lost(running: Running) -> None:
    within = threading.Lock()
    made: list[int] = []
    done = threading.Event()

    def call(number: int) -> None:
        assert within.acquire(blocking=False), "two calls at once"
        made.append(number)
        within.release()
        if len(made) == 4000:
            done.set()

    def submit(first: int) -> None:
        for number in range(first, first + 1000):
            submit_call = running.loop.deliver if first < 2000 else running.loop.post
            submit_call(lambda: call(number))  # noqa: B023 - may be any of them

    running.start()
    threads = [threading.Thread(target=submit, args=(first,)) for first in range(0, 4000, 1000)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LIMIT_S)

    assert done.wait(LIMIT_S), f"{len(made)} of 4000 calls were made"


def test_delivering_thread_returns_under_load_of_other_threads(running: Running) -> None:
    stop = threading.Event()
    made = threading.Event()

    def flood() -> None:
        if not stop.is_set():
            running.loop.post(flood)

    running.start()
    running.loop.post(flood)
    for _ in range(30):
        delivering = threading.Thread(target=running.loop.deliver, args=(made.set,), daemon=True)
        delivering.start()
        delivering.join(LIMIT_S)
        assert not delivering.is_alive(), "it makes the calls of others without end"
        assert made.wait(LIMIT_S)
        made.clear()
    stop.set()


def test_timer_set_during_sleep_wakes_the_loop(running: Running) -> None:
    clock = SystemClock()
    woken = threading.Event()
    running.loop.bind(woken.set)
    running.start()
    running.loop.deliver(lambda: running.loop.wake_at(clock.now() + 3_600_000_000_000))
    running.loop.deliver(lambda: running.loop.wake_at(clock.now() + 1_000_000))

    assert woken.wait(LIMIT_S)


def test_time_from_before_the_clock_was_set_back_wakes_the_loop_at_once(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    hour = 3_600_000_000_000
    set_back = 0
    monkeypatch.setattr(SystemClock, "now", lambda _: time.time_ns() - set_back)
    woken = threading.Event()
    running.loop.bind(woken.set)
    running.start()
    at = time.time_ns() + hour
    running.loop.deliver(lambda: running.loop.wake_at(at))
    set_back = hour  # while a call is in progress that sets the next timer by the time before
    running.loop.deliver(lambda: running.loop.wake_at(at))

    assert woken.wait(LIMIT_S)


def test_exception_in_a_call_ends_the_loop(running: Running) -> None:
    def fail() -> None:
        raise RuntimeError("boom")

    running.start()
    running.loop.deliver(fail)
    running.join()

    assert [str(failure) for failure in running.failure] == ["boom"]


def test_calls_after_the_end_are_discarded_and_released(running: Running) -> None:
    class Call:
        def __call__(self) -> None:
            raise AssertionError("called after the loop stopped")

    before, after = Call(), Call()
    gone = [weakref.ref(before), weakref.ref(after)]
    running.loop.post(running.loop.stop)
    running.loop.post(before)
    running.start()
    running.join()
    running.loop.post(after)
    running.loop.deliver(after)
    del before, after

    assert [one() for one in gone] == [None, None]
    assert running.failure == []
