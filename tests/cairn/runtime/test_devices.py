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
    """Posts calls from a thread of its own."""

    clock_source: ClassVar[Literal["deployment", "system", "device"]] = "device"
    latched: Out[String] = Out(qos=LATCHED)
    heard: Out[String]

    def on_configure(self) -> None:
        self.threads: list[str] = []
        self.called = threading.Event()

    def hear(self) -> None:
        self.threads.append(threading.current_thread().name)
        self.called.set()


def test_call_posted_by_another_thread_runs_as_a_handler() -> None:
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


def test_exception_in_a_posted_call_fails_the_component() -> None:
    def jam() -> None:
        raise ValueError("jammed")

    part = Threaded(Driver, LockstepBus())
    part.activate()
    part.runtime.component.post(jam)

    assert part.ended.wait(LIMIT_S)
    assert part.end is not None
    assert part.end.reason == "jam: ValueError: jammed"
    part.close()


def test_device_driver_rejects_lockstep_and_simulated_time(lockstep: Lockstep) -> None:
    refusal = "part: plugin test drives a device, which cannot follow simulated time"
    with pytest.raises(CairnError, match=refusal):
        lockstep.add(Driver)
    with pytest.raises(CairnError, match=refusal):
        Threaded(Driver, LockstepBus(), simulated_time=True)


def test_output_reports_whether_it_has_subscribers() -> None:
    bus = LockstepBus()
    part = Threaded(Driver, bus)
    driver = part.runtime.component
    assert isinstance(driver, Driver)
    assert not driver.heard.has_subscribers
    part.activate()
    assert not driver.heard.has_subscribers
    assert driver.latched.has_subscribers  # a late subscriber may appear
    reader = bus.node("/robot/reader", lambda complaint: None)
    reader.subscribe("/robot/heard", String, driver.heard.qos, lambda: None)
    assert driver.heard.has_subscribers
    part.ask("deactivate")
    assert not driver.heard.has_subscribers
    part.close()


def test_posting_works_in_lockstep(lockstep: Lockstep) -> None:
    placed = lockstep.add(Base)
    placed.activate()
    called: list[bool] = []
    placed.component.post(lambda: called.append(True))
    lockstep.run()

    assert called == [True]
