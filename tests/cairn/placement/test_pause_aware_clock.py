"""The pause-aware clock: time passes only while the machine lets a process run."""

import queue

import pytest

from cairn.placement.component_host import PAUSE_S, PERIOD_S, PauseAwareClock
from tests.patience import LIMIT_S


class Machine:
    """Time and processor time of a process, which the test controls."""

    def __init__(self) -> None:
        self.time_s = 100.0
        self.used_s = 0.0
        self.clock = PauseAwareClock(lambda: self.time_s, lambda: self.used_s)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.time_s += PERIOD_S
            self.used_s += PERIOD_S / 10
            self.clock.update()


def test_time_passes_like_the_clock_of_the_machine() -> None:
    machine = Machine()
    machine.run(10.0)
    machine.time_s += 0.125

    assert machine.clock.now() == 10.125


def test_pause_counts_for_one_second_at_most() -> None:
    machine = Machine()
    machine.run(1.0)
    machine.time_s += 60.0

    before = machine.clock.now()
    machine.clock.update()
    after = machine.clock.now()
    machine.run(1.0)

    assert before == after == 1.0 + PAUSE_S
    assert machine.clock.now() == 2.0 + PAUSE_S


def test_call_that_blocks_other_threads_does_not_count_as_a_pause() -> None:
    machine = Machine()
    machine.run(1.0)
    machine.time_s += 60.0
    machine.used_s += 59.0

    machine.clock.update()

    assert machine.clock.now() == 61.0


def test_clock_thread_runs_until_the_clock_is_closed() -> None:
    observations: queue.SimpleQueue[None] = queue.SimpleQueue()

    def processor_time() -> float:
        observations.put(None)
        return 0.0

    clock = PauseAwareClock(processor_time=processor_time)
    observations.get()  # that of the constructor
    clock.start()
    observations.get(timeout=LIMIT_S)
    observations.get(timeout=LIMIT_S)
    clock.close()

    while not observations.empty():
        observations.get()
    with pytest.raises(queue.Empty):
        observations.get(timeout=3 * PERIOD_S)
    PauseAwareClock().close()  # never started
