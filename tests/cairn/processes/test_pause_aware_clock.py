"""The pause-aware clock: time passes only while the machine lets a process run."""

import queue
import sys
import time

import pytest

from cairn.processes.component_process import PAUSE_S, PERIOD_S, PauseAwareClock
from tests.patience import LIMIT_S


class Machine:
    """The time of a machine, which the test controls."""

    def __init__(self) -> None:
        self.time_s = 100.0
        self.clock = PauseAwareClock(lambda: self.time_s)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.time_s += PERIOD_S
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


def test_time_in_which_a_computation_lets_no_other_thread_run_counts_as_a_pause() -> None:
    clock = PauseAwareClock()
    clock.start()
    interval = sys.getswitchinterval()
    try:
        before, end = clock.now(), time.monotonic() + 2.0
        sys.setswitchinterval(1000.0)  # other threads ask for the interpreter only after so long
        while time.monotonic() < end:
            pass
        clock.update()  # what its thread does as soon as it can
        assert clock.now() - before <= PAUSE_S + PERIOD_S
    finally:
        sys.setswitchinterval(interval)
        clock.close()


def test_clock_thread_runs_until_the_clock_is_closed() -> None:
    observations: queue.Queue[None] = queue.Queue()

    def monotonic() -> float:
        observations.put(None)
        return 0.0

    clock = PauseAwareClock(monotonic)
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
