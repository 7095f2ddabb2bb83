"""A conversation with a device is begun again until it is stopped; mistakes are no trouble."""

from __future__ import annotations

import logging
import threading

import pytest

from cairn import CairnError
from cairn.driver.device_thread import DeviceThread
from cairn.driver.errors import DeviceError
from tests.patience import LIMIT_S

LOG = logging.getLogger("test_device_thread")


def test_it_tries_again_after_trouble_and_says_when_all_is_well(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    talking, troubles = threading.Event(), list[DeviceError]()

    def converse(stopping: threading.Event) -> None:
        if len(troubles) < 3:
            raise DeviceError("no device")
        thread.well("the device is back")
        talking.set()
        stopping.wait(LIMIT_S)

    thread = DeviceThread(
        "driver", converse, log=LOG, on_trouble=troubles.append, on_failure=_never
    )
    thread.start()
    assert talking.wait(LIMIT_S)
    thread.stop()

    assert [str(trouble) for trouble in troubles] == ["no device"] * 3
    assert [record.message for record in caplog.records] == [
        "no device",
        "no device (2 times so far)",
        "the device is back",
    ]


def test_a_mistake_in_the_driver_ends_it() -> None:
    failed, failures = threading.Event(), list[Exception]()

    def converse(_: threading.Event) -> None:
        raise KeyError("a mistake")

    def fail(error: Exception) -> None:
        failures.append(error)
        failed.set()

    thread = DeviceThread("driver", converse, log=LOG, on_trouble=_never, on_failure=fail)
    thread.start()
    assert failed.wait(LIMIT_S)
    thread.stop()

    assert [type(failure) for failure in failures] == [KeyError]


def test_one_that_does_not_end_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cairn.driver.device_thread._STOP_LIMIT_S", 0.01)
    released, talking = threading.Event(), threading.Event()

    def converse(_: threading.Event) -> None:
        talking.set()
        released.wait(LIMIT_S)

    thread = DeviceThread("driver", converse, log=LOG, on_trouble=_never, on_failure=_never)
    thread.start()
    assert talking.wait(LIMIT_S)
    with pytest.raises(CairnError, match=r"driver: its thread does not end within 0\.01 s"):
        thread.stop()
    released.set()


def _never(error: Exception) -> None:
    raise AssertionError("there is no trouble") from error
