"""Periodic and scheduled calls follow the component's clock, also when it is set."""

from collections.abc import Callable
from typing import Any

import pytest

from cairn import SECOND, CairnError, Component, In, every, from_ns, on
from cairn.bus.lockstep_bus import LockstepBus
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.component import ComponentContext
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.runtime import Runtime
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.std_msgs import String
from cairn.testing.lockstep import ComponentHarness
from tests.wording import words_in_order


class TimeRecorder(Component):
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


def set_clock(harness: ComponentHarness[Any], *times: float) -> None:
    """Publish clock messages one after another."""
    for time in times:
        harness.publish("clock", Clock(clock=from_ns(seconds(time))))


def test_periodic_call_keeps_its_period() -> None:
    harness = ComponentHarness(TimeRecorder, activate=False)
    harness.run_to(seconds(0.05))
    harness.activate()
    harness.run_to(seconds(0.5))

    assert harness.component.ticks == [0.15, 0.25, 0.35, 0.45]


def test_missed_periods_are_skipped() -> None:
    harness = ComponentHarness(TimeRecorder, simulated_time=True)
    set_clock(harness, 0.05, 0.1, 0.15, 1.05, 1.08, 1.1, 1.25)

    assert harness.component.ticks == [0.1, 1.05, 1.1, 1.25]


def test_timers_follow_simulated_time_alone() -> None:
    harness = ComponentHarness(TimeRecorder, simulated_time=True)
    harness.run_to(100 * SECOND)
    assert (harness.component.ticks, harness.component.clock.now()) == ([], 0)

    set_clock(harness, 0.1)

    assert (harness.component.ticks, harness.component.clock.now()) == ([0.1], seconds(0.1))


def test_component_with_system_clock_ignores_simulated_time() -> None:
    class OnSystemTime(TimeRecorder):
        clock_source = "system"

    harness = ComponentHarness(OnSystemTime, simulated_time=True)
    harness.run_to(seconds(0.2))
    set_clock(harness, 50.0)

    assert harness.component.ticks == [0.1, 0.2]


def test_periodic_calls_restart_when_time_is_set_back() -> None:
    harness = ComponentHarness(TimeRecorder, simulated_time=True)
    set_clock(harness, 10.0, 10.1, 5.0, 5.05, 5.1, 5.2)

    assert harness.component.ticks == [10.0, 10.1, 5.1, 5.2]


def test_scheduled_call_comes_as_soon_when_time_is_set_back() -> None:
    harness = ComponentHarness(TimeRecorder, simulated_time=True)
    set_clock(harness, 10.0)
    harness.component.schedule(seconds(11.0), harness.component.note)
    set_clock(harness, 10.5, 5.0, 5.4, 5.5, 12.0)

    assert harness.component.calls == [5.5]


def test_system_clock_that_is_set_back_does_not_stop_timers() -> None:
    settable = Settable()
    launch = LaunchRequest(name="component", spec=ChildSpec(plugin="test"))
    runtime = Runtime(TimeRecorder, launch, LockstepBus(), settable, settable, lambda _: None)
    runtime.request("configure", {})
    runtime.request("activate", {})
    for time in (1000.0, 1000.1, 3.0, 3.1, 3.2):
        settable.time = seconds(time)
        settable.on_time()

    assert isinstance(runtime.component, TimeRecorder)
    assert runtime.component.ticks == [1000.0, 1000.1, 3.1, 3.2]
    assert settable.wake == seconds(3.3)


def test_scheduled_call_is_made_once_at_its_time() -> None:
    harness = ComponentHarness(TimeRecorder)
    harness.component.schedule(seconds(0.33), harness.component.note)
    harness.component.schedule(seconds(0.11), harness.component.note)
    harness.component.schedule(seconds(0.33), harness.component.note)
    harness.run_to(SECOND)

    assert harness.component.calls == [0.11, 0.33, 0.33]


@pytest.mark.parametrize("simulated_time", [True, False])
def test_call_scheduled_for_the_past_is_made_soon(simulated_time: bool) -> None:
    harness = ComponentHarness(TimeRecorder, simulated_time=simulated_time)
    harness.component.schedule(-5, harness.component.note)
    assert harness.component.calls == []
    harness.run_for(0)

    assert harness.component.calls == [0.0]


@pytest.mark.parametrize("simulated_time", [True, False])
def test_call_that_reschedules_itself_for_now_does_not_starve_others(simulated_time: bool) -> None:
    class Eager(TimeRecorder):
        received = False

        def again(self) -> None:
            self.note()
            if not self.received:
                self.schedule(self.clock.now(), self.again)

        @on("word")
        def receive(self, word: String) -> None:
            self.received = True

    harness = ComponentHarness(Eager, simulated_time=simulated_time)
    harness.component.schedule(0, harness.component.again)
    harness.publish("word", String(data="stop"))

    assert harness.component.received
    assert 1 <= len(harness.component.calls) < 10


def test_deactivation_discards_scheduled_calls() -> None:
    harness = ComponentHarness(TimeRecorder)
    harness.component.schedule(seconds(0.5), harness.component.note)
    harness.request("deactivate")
    harness.request("activate")
    harness.run_to(SECOND)

    assert harness.component.calls == []


def test_failed_periodic_call_runs_once_per_period_after_recovery() -> None:
    class Recovers(TimeRecorder):
        def on_error(self, error: Exception) -> bool:
            return True

        @every(hz=10)
        def tick(self) -> None:
            super().tick()
            if len(self.ticks) == 1:
                raise RuntimeError("once")

    harness = ComponentHarness(Recovers)
    harness.run_to(seconds(0.4))

    assert harness.component.ticks == [0.1, 0.2, 0.3, 0.4]


def test_invalid_rate_is_rejected() -> None:
    for hz in (0.0, -1.0, 1001.0, float("nan"), float("inf")):
        with pytest.raises(CairnError, match=words_in_order("rate", "above 0", "1000 Hz")):
            every(hz=hz)


class Settable:
    """A clock and scheduler that the test sets."""

    def __init__(self) -> None:
        self.time = seconds(999.9)
        self.wake = 0
        self.on_time: Callable[[], None] = lambda: None

    def now(self) -> int:
        return self.time

    def post(self, call: Callable[[], None]) -> None:
        call()

    deliver = receive = post

    def wake_at(self, time: int) -> None:
        self.wake = time

    def bind(self, on_time: Callable[[], None]) -> None:
        self.on_time = on_time

    def stop(self) -> None:
        pass
