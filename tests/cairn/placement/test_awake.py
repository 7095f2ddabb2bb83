"""Time that passes only while the machine lets a process run."""

import queue

import pytest

from cairn.placement.awake import LATE_S, TURN_S, AwakeTime
from tests.patience import LIMIT_S


class Machine:
    """Time and processor of a process, in the test's hands; it turns as often as it is let."""

    def __init__(self) -> None:
        self.time_s = 100.0
        self.used_s = 0.0
        self.awake = AwakeTime(lambda: self.time_s, lambda: self.used_s)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TURN_S)):
            self.time_s += TURN_S
            self.used_s += TURN_S / 10
            self.awake.turn()


def test_it_passes_as_the_machines_does() -> None:
    machine = Machine()
    machine.run(10.0)
    machine.time_s += 0.125

    assert machine.awake.now() == 10.125


def test_of_a_pause_next_to_nothing_counts_whoever_asks_first() -> None:
    machine = Machine()
    machine.run(1.0)
    machine.time_s += 60.0

    before = machine.awake.now()
    machine.awake.turn()
    after = machine.awake.now()
    machine.run(1.0)

    assert before == after == 1.0 + LATE_S
    assert machine.awake.now() == 2.0 + LATE_S


def test_a_call_that_lets_no_other_thread_run_is_no_pause() -> None:
    machine = Machine()
    machine.run(1.0)
    machine.time_s += 60.0
    machine.used_s += 59.0

    machine.awake.turn()

    assert machine.awake.now() == 61.0


def test_its_thread_looks_by_itself_and_ends() -> None:
    looks: queue.SimpleQueue[None] = queue.SimpleQueue()

    def processor() -> float:
        looks.put(None)
        return 0.0

    awake = AwakeTime(processor=processor)
    looks.get()  # the one at the beginning
    awake.start()
    looks.get(timeout=LIMIT_S)
    looks.get(timeout=LIMIT_S)
    awake.close()

    while not looks.empty():
        looks.get()
    with pytest.raises(queue.Empty):
        looks.get(timeout=3 * TURN_S)
    AwakeTime().close()  # never started
