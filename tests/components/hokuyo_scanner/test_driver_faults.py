"""Faults on the line: no wrong scan is published, and scans resume soon."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.hokuyo_scanner.component import HokuyoScanner
from cairn.components.hokuyo_scanner.emulator import EmulatedScip
from cairn.components.hokuyo_scanner.emulator_sensor import SentScan
from cairn.components.hokuyo_scanner.protocol import (
    ReplySplitter,
    ScanData,
    ScanParser,
    ScanRequest,
)
from cairn.components.hokuyo_scanner.sensor import StampedScan
from cairn.driver.diagnostics import ERROR, OK, WARN
from cairn.driver.emulator import Emulator, FrameFault, FrameFaults
from cairn.driver.emulator_lines import PtyEnd
from tests.components.hokuyo_scanner.emulated_driver import (
    REPLY_TIMEOUT_S,
    EmulatedDriver,
    assert_were_sent,
    emulated_driver,
)
from tests.patience import LIMIT_S

pytestmark = pytest.mark.slow


FAULTS: tuple[FrameFault, ...] = ("bad_sum", "cut", "garbage", "drop")

_ANY_RATE = 1.0  # the number of scans that a busy computer drops is not judged here


def assert_all_were_sent(setup: EmulatedDriver) -> None:
    """Check that every published scan was sent, and none was published twice."""
    assert_were_sent(setup.scans.all(), setup.sent, "UTM-30LX")


def values(status: Any) -> dict[str, str]:
    """Return the values of a status by key."""
    return {value.key: value.value for value in status.values}


def test_thousand_faults_cause_no_wrong_scan() -> None:
    faults = FrameFaults(dict.fromkeys(FAULTS, 0.2), np.random.default_rng(3))
    sent: list[SentScan] = []
    device = EmulatedScip("UTM-30LX", on_scan=sent.append)
    request = ScanRequest(0, 1080)
    device.receive(request.command + b"\n", 0.0)
    splitter, parser, now, parsed = ReplySplitter(), ScanParser(), 0.0, 0
    while faults.counts.total() < 1000:
        now += 0.025
        bytes_ = b"".join(map(faults.apply, device.tick(now)))
        for reply in splitter.feed(bytes_):
            data = parser.parse(reply, request, scip2=True)
            if data is not None:
                (one,) = [scan for scan in sent[-3:] if scan.time_ms == data.time_ms]
                assert np.array_equal(data.distances[:, 0], one.distances[:, 0])
                parsed += 1

    assert set(faults.counts) == set(FAULTS)
    assert parsed == parser.good >= 0.3 * len(sent)


@pytest.mark.parametrize("tcp", [False, True])
def test_scans_resume_after_faults_of_all_kinds(tmp_path: Path, tcp: bool) -> None:
    order = list(FAULTS) * 15
    np.random.default_rng(tcp).shuffle(order)
    with emulated_driver(tmp_path, tcp=tcp, reply_timeout_s=REPLY_TIMEOUT_S, restarts=1) as setup:
        setup.scans.wait(1)
        for fault in order:
            setup.emulator.inject(fault)
        setup.scans.wait_for(lambda scans: setup.emulator.injected == dict.fromkeys(FAULTS, 15))
        setup.scans.wait(5, after=len(setup.scans))

    assert_all_were_sent(setup)


@pytest.mark.parametrize("fault", FAULTS)
def test_damaged_scan_is_dropped_and_counted(tmp_path: Path, fault: FrameFault) -> None:
    with emulated_driver(tmp_path) as setup:
        setup.scans.wait(2)
        setup.emulator.inject(fault, 3)
        setup.scans.wait(10, after=len(setup.scans))

        def is_counted(status: Any) -> bool:
            found = values(status)
            counted = sum(
                int(found.get(key, 0)) for key in ("damaged replies", "bytes of no reply")
            )
            return counted >= 1 or fault not in ("bad_sum", "cut")

        # On a busy computer the scans before may all be older than the faults.
        report = setup.health(is_counted)

    assert_all_were_sent(setup)
    assert setup.emulator.injected == {fault: 3}
    assert values(report)["connections"] == "1"


def test_silent_sensor_gets_the_command_to_start_again(tmp_path: Path) -> None:
    reports: list[Any] = []
    with emulated_driver(tmp_path, silence_s=0.2) as setup:
        setup.scans.wait(2)
        # If the computer pauses as well, a report of an error may take this one's place.
        for _ in range(20):
            setup.emulator.call(
                lambda: setup.device.receive(b"QT\n", 0.0)
            )  # as if it had stopped by itself
            setup.scans.wait(3, after=len(setup.scans))
            setup.health(lambda status: True)
            reports = [one.status[0] for one in setup.diagnostics.all()]
            if any("stopped sending" in report.message for report in reports):
                break

    levels = {report.level for report in reports if "stopped sending" in report.message}
    assert levels == {WARN}


def test_scans_resume_after_a_hang(tmp_path: Path) -> None:
    with emulated_driver(
        tmp_path, silence_s=0.1, rate_tolerance=_ANY_RATE,
        reply_timeout_s=REPLY_TIMEOUT_S, restarts=1,
    ) as setup:  # fmt: skip
        setup.scans.wait(2)
        setup.emulator.hang()
        report = setup.health(lambda status: status.level == ERROR)
        before = len(setup.scans)
        setup.emulator.hang(0.0)
        setup.scans.wait(3, after=before)
        setup.health(lambda status: status.level == OK)

    assert "scanner" in report.message
    assert_all_were_sent(setup)


@pytest.mark.parametrize("tcp", [False, True])
def test_scans_resume_after_unplugging(tmp_path: Path, tcp: bool) -> None:
    with emulated_driver(tmp_path, tcp=tcp, rate_tolerance=_ANY_RATE) as setup:
        setup.scans.wait(2)
        setup.emulator.unplug()
        report = setup.health(lambda status: status.level == ERROR)
        before = len(setup.scans)
        setup.emulator.plug_in()
        setup.scans.wait(3, after=before)
        setup.health(lambda status: status.level == OK)

    assert any(word in report.message for word in ("cannot be", "gone", "closed"))
    assert_all_were_sent(setup)


def test_sensor_may_be_unplugged_while_inactive(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, activate=False) as setup:
        setup.component.request("configure")
        setup.emulator.unplug()
        setup.component.request("activate")
        setup.health(lambda status: status.level == ERROR)
        setup.emulator.plug_in()
        setup.scans.wait(2)
        setup.emulator.unplug()
        setup.component.request("deactivate")
        setup.component.request("cleanup")


@pytest.mark.parametrize("status", ["0M", "21", "98"])
def test_statuses_in_a_stream_are_counted_but_not_as_damage(tmp_path: Path, status: str) -> None:
    with emulated_driver(tmp_path) as setup:
        setup.scans.wait(2)
        setup.emulator.call(lambda: setup.device.send_status(status, 2))
        setup.scans.wait(5, after=len(setup.scans))
        report = setup.health(lambda report: values(report).get(f"status {status}") == "2")

    assert values(report)["damaged replies"] == "0"


def test_reported_defect_is_an_error_with_its_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The next attempt to connect has another error: the sensor refuses to work.
    monkeypatch.setattr("cairn.driver.device_thread.RETRY_S", LIMIT_S)
    with emulated_driver(tmp_path) as setup:
        setup.scans.wait(2)
        setup.emulator.call(lambda: setup.device.send_status("55"))
        report = setup.health(lambda status: status.level == ERROR)

    assert "55" in report.message


def test_restarted_driver_waits_for_its_sensor(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, activate=False, restarts=1) as setup:
        setup.emulator.unplug()
        setup.component.activate()
        setup.health(lambda status: status.level == ERROR)
        setup.emulator.plug_in()
        setup.scans.wait(2)


def test_scans_received_during_deactivation_are_not_published_later(tmp_path: Path) -> None:
    with emulated_driver(tmp_path) as setup:
        driver = setup.component.runtime.component
        assert isinstance(driver, HokuyoScanner)
        setup.scans.wait(1)
        sensor = driver._measurement.sensor
        assert sensor is not None
        last = StampedScan(ScanData(0, np.zeros((1, 1), np.int32)), ScanRequest(0, 0), sensor, 0)
        for _ in range(3):
            setup.scans.wait(3, after=len(setup.scans))
            setup.component.request("deactivate")
            driver._feed.put(last)
            setup.component.request("activate")
        setup.scans.wait(3, after=len(setup.scans))

    assert_all_were_sent(setup)


def test_parameters_are_checked_while_unplugged_too(tmp_path: Path) -> None:
    with emulated_driver(tmp_path) as setup:
        setup.scans.wait(1)
        setup.emulator.unplug()
        setup.health(lambda status: status.level == ERROR)
        with pytest.raises(CairnError, match="no two rays"):
            setup.component.set_parameters({"angle_min": 2.4, "angle_max": 2.5})
        setup.component.set_parameters({"angle_min": 0.0})
        before = len(setup.scans)
        setup.emulator.plug_in()
        assert setup.scans.wait(1, after=before)[0].angle_min == pytest.approx(0.0, abs=0.01)


class SilentDevice:
    """Receives everything and sends nothing."""

    def __init__(self) -> None:
        self.is_searched = threading.Event()

    def receive(self, data: bytes, now: float) -> list[bytes]:
        if b"QT" in data:
            self.is_searched.set()
        return []

    def due(self) -> float:
        return math.inf

    def tick(self, now: float) -> list[bytes]:
        return []

    def disconnected(self, now: float) -> None:
        """Ignore it."""

    def powered_on(self, now: float) -> None:
        """Ignore it."""

    def baud(self) -> int | None:
        return None


def test_driver_stops_while_it_searches_for_a_sensor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.components.hokuyo_scanner.client._REPLY_TIMEOUT_S", 2.0 * LIMIT_S)
    port = tmp_path / "scanner"
    device = SilentDevice()
    with Emulator(device, PtyEnd(port)) as emulator:
        setup = EmulatedDriver(emulator, device, [], restarts=1, port=str(port))
        try:
            emulator.unplug()
            setup.component.request("configure")
            emulator.plug_in()
            setup.component.request("activate")
            assert device.is_searched.wait(LIMIT_S)
            setup.component.request("deactivate")  # a speed takes longer than this may
            setup.component.request("cleanup")
        finally:
            setup.component.close()


def test_sensor_that_does_not_stop_is_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with emulated_driver(tmp_path, reply_timeout_s=REPLY_TIMEOUT_S, restarts=1) as setup:
        setup.scans.wait(2)
        setup.emulator.hang()
        setup.component.request("deactivate")
        setup.emulator.hang(0.0)

    assert "its laser may still be on" in caplog.text
