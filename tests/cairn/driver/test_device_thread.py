"""Device threads reopen a failed device; feeds publish its measurements, or drop the oldest."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future

import pytest

from cairn import CairnError, Component
from cairn.bus.lockstep_bus import LockstepBus
from cairn.driver.device_thread import RETRY_S, DeviceFeed, DeviceThread
from cairn.driver.errors import DeviceError
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.patience import LIMIT_S
from tests.wording import assert_words, words_in_order

LOG = logging.getLogger("test_device_thread")


def test_failed_device_is_opened_again_and_its_recovery_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    serving, errors = threading.Event(), list[DeviceError]()

    def serve(stopping: threading.Event) -> None:
        if len(errors) < 3:
            raise DeviceError("no device")
        thread.report_working("the device is back")
        serving.set()
        stopping.wait(LIMIT_S)

    thread = DeviceThread(
        "driver", serve, log=LOG, on_device_error=errors.append, on_failure=_unexpected
    )
    thread.start()
    assert serving.wait(LIMIT_S)
    thread.stop()

    assert [str(error) for error in errors] == ["no device"] * 3
    messages = [record.message for record in caplog.records if record.name == LOG.name]
    assert messages[0] == "no device"
    assert messages[-1] == "the device is back"
    assert len(messages) == 3  # the second and third failure are one warning
    assert "2 times" in messages[1]


def test_failed_device_is_opened_again_after_a_pause() -> None:
    retried, attempts = threading.Event(), list[float]()

    def serve(_: threading.Event) -> None:
        attempts.append(time.monotonic())
        if len(attempts) > 1:
            retried.set()
        raise DeviceError("no device")

    thread = DeviceThread(
        "driver", serve, log=LOG, on_device_error=lambda _: None, on_failure=_unexpected
    )
    thread.start()
    assert retried.wait(LIMIT_S)
    thread.stop()

    assert attempts[1] - attempts[0] > 0.9 * RETRY_S


def test_bug_in_the_driver_is_not_retried() -> None:
    def serve(_: threading.Event) -> None:
        raise KeyError("a bug")

    assert [type(failure) for failure in failures_of(serve)] == [KeyError]


def test_vendor_library_that_calls_sys_exit_fails_the_driver() -> None:
    def serve(_: threading.Event) -> None:
        sys.exit(3)

    (failure,) = failures_of(serve)
    assert_words(str(failure), "driver", "sys.exit(3)", "DeviceError")


def failures_of(serve: Callable[[threading.Event], None]) -> list[Exception]:
    """Return the failures that a device thread has reported by its end."""
    serving, failures = threading.Event(), list[Exception]()

    def observed(stopping: threading.Event) -> None:
        serving.set()
        serve(stopping)

    thread = DeviceThread(
        "driver", observed, log=LOG, on_device_error=_unexpected, on_failure=failures.append
    )
    thread.start()
    assert serving.wait(LIMIT_S)
    thread.stop()
    return failures


def test_thread_that_does_not_stop_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cairn.driver.device_thread._STOP_LIMIT_S", 0.01)
    released, serving = threading.Event(), threading.Event()

    def serve(_: threading.Event) -> None:
        serving.set()
        released.wait(LIMIT_S)

    thread = DeviceThread(
        "driver", serve, log=LOG, on_device_error=_unexpected, on_failure=_unexpected
    )
    thread.start()
    assert serving.wait(LIMIT_S)
    with pytest.raises(CairnError, match=words_in_order("driver", "did not stop", "0.01 s")):
        thread.stop()
    released.set()


class Driver(Component):
    """Its device fails once, then measures eight numbers at once; on demand it has a bug."""

    def on_configure(self) -> None:
        self.feed = DeviceFeed(self, self._serve, self._publish)
        self.published: list[int] = []
        self.all_published = threading.Event()
        self.failed_once, self.all_measured = threading.Event(), threading.Event()
        self.measure, self.err = threading.Event(), threading.Event()
        self._attempts = 0

    def on_activate(self) -> None:
        self.feed.start()

    def on_deactivate(self) -> None:
        self.feed.stop()

    def on_error(self, error: Exception) -> bool:
        self.feed.stop()
        return False

    def be_busy(self) -> None:
        """Block all handlers until the device has measured everything."""
        assert self.all_measured.wait(LIMIT_S)

    def _serve(self, stopping: threading.Event) -> None:
        self._attempts += 1
        if self._attempts == 1:
            raise DeviceError("no device")
        self.failed_once.set()
        assert self.measure.wait(LIMIT_S)
        for number in range(8):
            self.feed.put(number)
        self.all_measured.set()
        while not stopping.wait(0.01):
            if self.err.is_set():
                raise KeyError("a bug")

    def _publish(self, number: int) -> None:
        self.published.append(number)
        if number == 7:
            self.all_published.set()


@pytest.fixture
def running() -> Iterator[ThreadedComponent]:
    threaded = ThreadedComponent(Driver, LockstepBus())
    threaded.activate()
    yield threaded
    threaded.close()


def driver_of(running: ThreadedComponent) -> Driver:
    driver = running.runtime.component
    assert isinstance(driver, Driver)
    return driver


def test_device_error_is_reported_until_a_measurement_arrives(running: ThreadedComponent) -> None:
    driver = driver_of(running)
    assert driver.failed_once.wait(LIMIT_S)
    error: Future[str] = Future()
    running.loop.post(lambda: error.set_result(driver.feed.device_error))
    assert error.result(LIMIT_S) == "no device"

    driver.measure.set()
    assert driver.all_published.wait(LIMIT_S)

    assert driver.feed.device_error == ""


def test_oldest_measurements_are_dropped_if_the_component_is_busy(
    running: ThreadedComponent,
) -> None:
    driver = driver_of(running)
    assert driver.failed_once.wait(LIMIT_S)
    running.loop.post(driver.be_busy)
    driver.measure.set()
    assert driver.all_published.wait(LIMIT_S)

    assert driver.published[-5:] == [3, 4, 5, 6, 7]
    assert driver.feed.dropped == 8 - len(driver.published)


def test_bug_on_the_device_thread_fails_the_component(running: ThreadedComponent) -> None:
    driver = driver_of(running)
    driver.measure.set()
    assert driver.all_measured.wait(LIMIT_S)
    driver.err.set()

    assert running.ended.wait(LIMIT_S)
    assert "a bug" in str(running.end)


def _unexpected(error: Exception) -> None:
    raise AssertionError("no error is expected") from error
