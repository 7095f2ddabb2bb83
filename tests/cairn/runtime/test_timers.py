"""Periodic and scheduled calls follow the component's clock, also when it is set."""

from collections.abc import Callable

import pytest

from cairn import SECOND, CairnError, Component, In, every, from_ns, on
from cairn.bus.lockstep_bus import LockstepBus
from cairn.deployment.model import ChildSpec
from cairn.runtime.component import ComponentContext
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.runtime import Runtime
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.std_msgs import String
from tests.cairn.runtime.running import Lockstep, Placed


class Part(Component):
    """Records when it is called."""

    word: In[String]

    def __init__(self, context: ComponentContext) -> None:
        super().__init__(context)
        self.ticks: list[float] = []
        self.calls: list[float] = []

    @every(hz=10)
    def tick(self) -> None:
        self.ticks.append(self.clock.now() / SECOND)

    def note(self) -> None:
        self.calls.append(self.clock.now() / SECOND)


def seconds(time: float) -> int:
    return round(time * SECOND)


def set_clock(lockstep: Lockstep, *times: float) -> None:
    """Publish clock messages one after another."""
    for time in times:
        lockstep.publish("clock", Clock(clock=from_ns(seconds(time))))
        lockstep.run()


def simulated(lockstep: Lockstep) -> Placed[Part]:
    part = lockstep.add(Part, simulated_time=True)
    part.activate()
    return part


def test_periodic_call_keeps_its_period(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    lockstep.run_until(seconds(0.05))
    part.activate()
    lockstep.run_until(seconds(0.5))

    assert part.component.ticks == [0.15, 0.25, 0.35, 0.45]


def test_missed_periods_are_skipped(lockstep: Lockstep) -> None:
    part = simulated(lockstep)
    set_clock(lockstep, 0.05, 0.1, 0.15, 1.05, 1.08, 1.1, 1.25)

    assert part.component.ticks == [0.1, 1.05, 1.1, 1.25]


def test_timers_follow_simulated_time_alone(lockstep: Lockstep) -> None:
    part = simulated(lockstep)
    lockstep.run_until(100 * SECOND)
    assert (part.component.ticks, part.component.clock.now()) == ([], 0)

    set_clock(lockstep, 0.1)

    assert (part.component.ticks, part.component.clock.now()) == ([0.1], seconds(0.1))


def test_component_with_system_clock_ignores_simulated_time(lockstep: Lockstep) -> None:
    class OnSystemTime(Part):
        clock_source = "system"

    part = lockstep.add(OnSystemTime, simulated_time=True)
    part.activate()
    lockstep.run_until(seconds(0.2))
    set_clock(lockstep, 50.0)

    assert part.component.ticks == [0.1, 0.2]


def test_periodic_calls_restart_when_time_is_set_back(lockstep: Lockstep) -> None:
    part = simulated(lockstep)
    set_clock(lockstep, 10.0, 10.1, 5.0, 5.05, 5.1, 5.2)

    assert part.component.ticks == [10.0, 10.1, 5.1, 5.2]


def test_scheduled_call_waits_for_its_time_when_time_is_set_back(lockstep: Lockstep) -> None:
    part = simulated(lockstep)
    set_clock(lockstep, 10.0)
    part.component.schedule(seconds(11.0), part.component.note)
    set_clock(lockstep, 5.0, 10.5, 11.0, 12.0)

    assert part.component.calls == [11.0]


def test_system_clock_that_is_set_back_does_not_stop_timers() -> None:
    settable = Settable()
    launch = LaunchRequest(name="part", spec=ChildSpec(plugin="test"))
    part = Runtime(Part, launch, LockstepBus(), settable, settable, lambda _: None)
    part.request("configure", {})
    part.request("activate", {})
    for time in (1000.0, 1000.1, 3.0, 3.1, 3.2):
        settable.time = seconds(time)
        settable.on_time()

    assert isinstance(part.component, Part)
    assert part.component.ticks == [1000.0, 1000.1, 3.1, 3.2]
    assert settable.wake == seconds(3.3)


def test_scheduled_call_is_made_once_at_its_time(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    part.activate()
    part.component.schedule(seconds(0.33), part.component.note)
    part.component.schedule(seconds(0.11), part.component.note)
    part.component.schedule(seconds(0.33), part.component.note)
    lockstep.run_until(SECOND)

    assert part.component.calls == [0.11, 0.33, 0.33]


@pytest.mark.parametrize("add", [lambda one: one.add(Part), simulated])
def test_call_scheduled_for_the_past_is_made_soon(
    lockstep: Lockstep, add: Callable[[Lockstep], Placed[Part]]
) -> None:
    part = add(lockstep)
    if part.state != "active":
        part.activate()
    part.component.schedule(-5, part.component.note)
    assert part.component.calls == []
    lockstep.run()

    assert part.component.calls == [0.0]


@pytest.mark.parametrize("simulated_time", [True, False])
def test_call_that_reschedules_itself_for_now_does_not_starve_others(
    lockstep: Lockstep, simulated_time: bool
) -> None:
    class Eager(Part):
        heard = False

        def again(self) -> None:
            self.note()
            if not self.heard:
                self.schedule(self.clock.now(), self.again)

        @on("word")
        def hear(self, word: String) -> None:
            self.heard = True

    part = lockstep.add(Eager, simulated_time=simulated_time)
    part.activate()
    part.component.schedule(0, part.component.again)
    lockstep.executor.at(0, lambda: lockstep.publish("word", String(data="stop")))
    lockstep.run()

    assert part.component.heard
    assert 1 <= len(part.component.calls) < 10


def test_deactivation_discards_scheduled_calls(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    part.activate()
    part.component.schedule(seconds(0.5), part.component.note)
    part.ask("deactivate")
    part.ask("activate")
    lockstep.run_until(SECOND)

    assert part.component.calls == []


def test_failed_periodic_call_runs_once_per_period_after_recovery(lockstep: Lockstep) -> None:
    class Recovers(Part):
        def on_error(self, error: Exception) -> bool:
            return True

        @every(hz=10)
        def tick(self) -> None:
            super().tick()
            if len(self.ticks) == 1:
                raise RuntimeError("once")

    part = lockstep.add(Recovers)
    part.activate()
    lockstep.run_until(seconds(0.4))

    assert part.component.ticks == [0.1, 0.2, 0.3, 0.4]


def test_invalid_rate_is_rejected() -> None:
    for hz in (0.0, -1.0, 1001.0, float("nan"), float("inf")):
        with pytest.raises(CairnError, match="a rate must be above 0 and at most 1000 Hz"):
            every(hz=hz)


class Settable:
    """A clock and scheduler in the hands of the test."""

    def __init__(self) -> None:
        self.time = seconds(999.9)
        self.wake = 0
        self.on_time: Callable[[], None] = lambda: None

    def now(self) -> int:
        return self.time

    def post(self, call: Callable[[], None]) -> None:
        call()

    deliver = post

    def wake_at(self, time: int) -> None:
        self.wake = time

    def bind(self, on_time: Callable[[], None]) -> None:
        self.on_time = on_time

    def stop(self) -> None:
        pass
