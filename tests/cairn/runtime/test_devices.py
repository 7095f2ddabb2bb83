"""Drivers of devices: calls from threads of their own, and the system's time alone."""

from __future__ import annotations

import threading
from typing import ClassVar, Literal

import pytest

from cairn import LATCHED, CairnError, Component, Out
from cairn.bus.lockstep_bus import LockstepBus
from cairn.schemas.std_msgs import String
from tests.cairn.runtime.base import Base
from tests.cairn.runtime.running import Lockstep, Threaded
from tests.patience import LIMIT_S


class Driver(Component):
    """Hears from a thread of its own."""

    clock_source: ClassVar[Literal["deployment", "system", "device"]] = "device"
    latched: Out[String] = Out(qos=LATCHED)
    heard: Out[String]

    def on_configure(self) -> None:
        self.threads: list[str] = []
        self.called = threading.Event()

    def hear(self) -> None:
        self.threads.append(threading.current_thread().name)
        self.called.set()


def test_what_another_thread_posts_is_called_as_a_handler() -> None:
    part = Threaded(Driver, LockstepBus())
    driver = part.runtime.component
    assert isinstance(driver, Driver)
    part.activate()
    driver.post(driver.hear)

    assert driver.called.wait(LIMIT_S)
    assert driver.threads != [threading.current_thread().name]
    part.ask("deactivate")
    driver.called.clear()
    driver.post(driver.hear)
    part.ask("activate")  # answered after what was posted
    assert not driver.called.is_set()
    part.close()


def test_what_is_raised_in_a_posted_call_fails_the_component() -> None:
    def jam() -> None:
        raise ValueError("jammed")

    part = Threaded(Driver, LockstepBus())
    part.activate()
    part.runtime.component.post(jam)

    assert part.ended.wait(LIMIT_S)
    assert part.end is not None
    assert part.end.reason == "jam: ValueError: jammed"
    part.close()


def test_lockstep_and_simulated_time_are_refused(lockstep: Lockstep) -> None:
    refusal = "part: plugin test drives a device, which cannot follow simulated time"
    with pytest.raises(CairnError, match=refusal):
        lockstep.add(Driver)
    with pytest.raises(CairnError, match=refusal):
        Threaded(Driver, LockstepBus(), simulated_time=True)


def test_an_output_knows_whether_anybody_reads() -> None:
    bus = LockstepBus()
    part = Threaded(Driver, bus)
    driver = part.runtime.component
    assert isinstance(driver, Driver)
    assert not driver.heard.has_subscribers
    part.activate()
    assert not driver.heard.has_subscribers
    assert driver.latched.has_subscribers  # somebody may come later
    reader = bus.node("/robot/reader", lambda complaint: None)
    reader.subscribe("/robot/heard", String, driver.heard.qos, lambda: None)
    assert driver.heard.has_subscribers
    part.ask("deactivate")
    assert not driver.heard.has_subscribers
    part.close()


def test_other_components_may_post_in_lockstep_too(lockstep: Lockstep) -> None:
    placed = lockstep.add(Base)
    placed.activate()
    called: list[bool] = []
    placed.component.post(lambda: called.append(True))
    lockstep.run()

    assert called == [True]
