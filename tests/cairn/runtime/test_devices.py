"""Drivers of devices: calls from threads of their own, and the system's time alone."""

from __future__ import annotations

import threading
from typing import ClassVar, Literal

import pytest

from cairn import LATCHED, CairnError, Component, Out
from cairn.bus.lockstep_bus import LockstepBus
from cairn.schemas.std_msgs import String
from cairn.testing.lockstep import ComponentHarness
from tests.cairn.runtime.base import Base
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.patience import LIMIT_S


class Driver(Component):
    """Posts calls from a thread of its own."""

    clock_source: ClassVar[Literal["deployment", "system", "device"]] = "device"
    latched: Out[String] = Out(qos=LATCHED)
    echo: Out[String]

    def on_configure(self) -> None:
        self.threads: list[str] = []
        self.called = threading.Event()

    def note_thread(self) -> None:
        self.threads.append(threading.current_thread().name)
        self.called.set()


def test_call_posted_by_another_thread_runs_as_a_handler() -> None:
    threaded = ThreadedComponent(Driver, LockstepBus())
    driver = threaded.runtime.component
    assert isinstance(driver, Driver)
    threaded.activate()
    driver.post(driver.note_thread)

    assert driver.called.wait(LIMIT_S)
    assert driver.threads != [threading.current_thread().name]
    threaded.request("deactivate")
    driver.called.clear()
    driver.post(driver.note_thread)
    threaded.request("activate")  # answered after what was posted
    assert not driver.called.is_set()
    threaded.close()


def test_exception_in_a_posted_call_fails_the_component() -> None:
    def jam() -> None:
        raise ValueError("jammed")

    threaded = ThreadedComponent(Driver, LockstepBus())
    threaded.activate()
    threaded.runtime.component.post(jam)

    assert threaded.ended.wait(LIMIT_S)
    assert threaded.end is not None
    assert threaded.end.reason == "jam: ValueError: jammed"
    threaded.close()


def test_device_driver_rejects_lockstep_and_simulated_time() -> None:
    error = r"component: plugin .*\bDriver\b .* device.* simulated time; .*`clock: system`"
    with pytest.raises(CairnError, match=error):
        ComponentHarness(Driver)
    with pytest.raises(CairnError, match=error):
        ThreadedComponent(Driver, LockstepBus(), simulated_time=True)


def test_output_reports_whether_it_has_subscribers() -> None:
    bus = LockstepBus()
    threaded = ThreadedComponent(Driver, bus)
    driver = threaded.runtime.component
    assert isinstance(driver, Driver)
    assert not driver.echo.has_subscribers
    threaded.activate()
    assert not driver.echo.has_subscribers
    assert driver.latched.has_subscribers  # a late subscriber may appear
    reader = bus.node("/robot/reader", lambda complaint: None)
    reader.subscribe("/robot/echo", String, driver.echo.qos, lambda: None)
    assert driver.echo.has_subscribers
    threaded.request("deactivate")
    assert not driver.echo.has_subscribers
    threaded.close()


def test_posting_works_in_lockstep() -> None:
    harness = ComponentHarness(Base)
    called: list[bool] = []
    harness.component.post(lambda: called.append(True))
    harness.run_for(0)

    assert called == [True]
