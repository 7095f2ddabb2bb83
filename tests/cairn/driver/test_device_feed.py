"""What a device's thread hears is published by the component; the newest, if that is busy."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future

import pytest

from cairn import Component
from cairn.bus.lockstep_bus import LockstepBus
from cairn.driver.device_feed import DeviceFeed
from cairn.driver.errors import DeviceError
from tests.cairn.runtime.running import Threaded
from tests.patience import LIMIT_S


class Driver(Component):
    """Has a device that fails once, then tells eight numbers at once, and at last errs."""

    def on_configure(self) -> None:
        self.feed = DeviceFeed(self, self._converse, self._publish)
        self.published: list[int] = []
        self.all_published = threading.Event()
        self.failed_once, self.told = threading.Event(), threading.Event()
        self.tell, self.err = threading.Event(), threading.Event()
        self._conversations = 0

    def on_activate(self) -> None:
        self.feed.start()

    def on_deactivate(self) -> None:
        self.feed.stop()

    def on_error(self, error: Exception) -> bool:
        self.feed.stop()
        return False

    def be_busy(self) -> None:
        """Hold all handlers up until the device has told all."""
        assert self.told.wait(LIMIT_S)

    def _converse(self, stopping: threading.Event) -> None:
        self._conversations += 1
        if self._conversations == 1:
            raise DeviceError("no device")
        self.failed_once.set()
        assert self.tell.wait(LIMIT_S)
        for number in range(8):
            self.feed.give(number)
        self.told.set()
        while not stopping.wait(0.01):
            if self.err.is_set():
                raise KeyError("a mistake")

    def _publish(self, number: int) -> None:
        self.published.append(number)
        if number == 7:
            self.all_published.set()


@pytest.fixture
def running() -> Iterator[Threaded]:
    it = Threaded(Driver, LockstepBus())
    it.activate()
    yield it
    it.close()


def driver_of(running: Threaded) -> Driver:
    driver = running.runtime.component
    assert isinstance(driver, Driver)
    return driver


def test_trouble_is_told_until_something_comes(running: Threaded) -> None:
    driver = driver_of(running)
    assert driver.failed_once.wait(LIMIT_S)
    trouble: Future[str] = Future()
    running.loop.post(lambda: trouble.set_result(driver.feed.trouble))
    assert trouble.result(LIMIT_S) == "no device"

    driver.tell.set()
    assert driver.all_published.wait(LIMIT_S)

    assert driver.feed.trouble == ""


def test_the_oldest_go_if_the_component_is_busy(running: Threaded) -> None:
    driver = driver_of(running)
    assert driver.failed_once.wait(LIMIT_S)
    running.loop.post(driver.be_busy)
    driver.tell.set()
    assert driver.all_published.wait(LIMIT_S)

    assert driver.published[-5:] == [3, 4, 5, 6, 7]
    assert driver.feed.left_out == 8 - len(driver.published)


def test_a_mistake_in_the_conversation_fails_the_component(running: Threaded) -> None:
    driver = driver_of(running)
    driver.tell.set()
    assert driver.told.wait(LIMIT_S)
    driver.err.set()

    assert running.ended.wait(LIMIT_S)
    assert "a mistake" in str(running.end)
