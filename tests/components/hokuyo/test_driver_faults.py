"""Faults on the line: no wrong scan is published, and scans resume soon."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.hokuyo.component import HokuyoScanner
from cairn.components.hokuyo.emulator import EmulatedScip
from cairn.components.hokuyo.emulator_sensor import SentScan
from cairn.components.hokuyo.protocol import ReplySplitter, ScanData, ScanParser, ScanRequest
from cairn.components.hokuyo.sensor import StampedScan
from cairn.driver.diagnostics import ERROR, OK, WARN
from cairn.driver.emulator import Emulator, FrameFault, FrameFaults
from cairn.driver.emulator_lines import PtyEnd
from tests.components.hokuyo.driving import Driven, assert_were_sent, driven
from tests.patience import LIMIT_S

pytestmark = pytest.mark.slow


FAULTS: tuple[FrameFault, ...] = ("bad_sum", "cut", "garbage", "drop")

_ANY_RATE = 1.0  # the number of scans that a busy computer drops is not judged here


def assert_all_were_sent(it: Driven) -> None:
    """Check that every published scan was sent, and none was published twice."""
    assert_were_sent(it.scans.all(), it.sent, "UTM-30LX")


def values(status: Any) -> dict[str, str]:
    """Return the values of a status by key."""
    return {value.key: value.value for value in status.values}


def test_no_fault_of_a_thousand_makes_a_wrong_scan() -> None:
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
    with driven(tmp_path, tcp=tcp) as it:
        it.scans.wait(1)
        for fault in order:
            it.emulator.inject(fault)
        it.scans.wait_for(lambda scans: it.emulator.injected == dict.fromkeys(FAULTS, 15))
        it.scans.wait(5, after=len(it.scans))

    assert_all_were_sent(it)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_damaged_scan_is_dropped_and_counted(tmp_path: Path, fault: FrameFault) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.inject(fault, 3)
        it.scans.wait(10, after=len(it.scans))
        report = it.health(lambda status: True)

    assert_all_were_sent(it)
    assert it.emulator.injected == {fault: 3}
    assert values(report)["connections"] == "1"
    if fault in ("bad_sum", "cut"):
        assert (
            int(values(report)["damaged replies"]) + int(values(report)["bytes of no reply"]) >= 1
        )


def test_a_silent_sensor_gets_the_command_to_start_again(tmp_path: Path) -> None:
    with driven(tmp_path, silence_s=0.2) as it:
        it.scans.wait(2)
        it.emulator.call(lambda: it.device.receive(b"QT\n", 0.0))  # as if it had stopped by itself
        it.scans.wait(3, after=len(it.scans))
        report = it.health(lambda status: "stopped sending" in status.message, after=0)

    assert report.level == WARN


def test_scans_resume_after_a_hang(tmp_path: Path) -> None:
    with driven(tmp_path, silence_s=0.1, rate_tolerance=_ANY_RATE) as it:
        it.scans.wait(2)
        it.emulator.hang()
        report = it.health(lambda status: status.level == ERROR)
        before = len(it.scans)
        it.emulator.hang(0.0)
        it.scans.wait(3, after=before)
        it.health(lambda status: status.level == OK)

    assert "scanner" in report.message
    assert_all_were_sent(it)


@pytest.mark.parametrize("tcp", [False, True])
def test_scans_resume_after_unplugging(tmp_path: Path, tcp: bool) -> None:
    with driven(tmp_path, tcp=tcp, rate_tolerance=_ANY_RATE) as it:
        it.scans.wait(2)
        it.emulator.unplug()
        report = it.health(lambda status: status.level == ERROR)
        before = len(it.scans)
        it.emulator.plug_in()
        it.scans.wait(3, after=before)
        it.health(lambda status: status.level == OK)

    assert any(word in report.message for word in ("cannot be", "gone", "closed"))
    assert_all_were_sent(it)


def test_a_sensor_may_be_unplugged_while_inactive(tmp_path: Path) -> None:
    with driven(tmp_path, activate=False) as it:
        it.component.ask("configure")
        it.emulator.unplug()
        it.component.ask("activate")
        it.health(lambda status: status.level == ERROR)
        it.emulator.plug_in()
        it.scans.wait(2)
        it.emulator.unplug()
        it.component.ask("deactivate")
        it.component.ask("cleanup")


@pytest.mark.parametrize("status", ["0M", "21", "98"])
def test_statuses_in_a_stream_are_counted_but_not_as_damage(tmp_path: Path, status: str) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.call(lambda: it.device.send_status(status, 2))
        it.scans.wait(5, after=len(it.scans))
        report = it.health(lambda report: values(report).get(f"status {status}") == "2")

    assert values(report)["damaged replies"] == "0"


def test_a_reported_defect_is_an_error_with_its_status(tmp_path: Path) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.call(lambda: it.device.send_status("55"))
        report = it.health(lambda status: status.level == ERROR)

    assert "55" in report.message


def test_a_restarted_driver_waits_for_its_sensor(tmp_path: Path) -> None:
    with driven(tmp_path, activate=False, restarts=1) as it:
        it.emulator.unplug()
        it.component.activate()
        it.health(lambda status: status.level == ERROR)
        it.emulator.plug_in()
        it.scans.wait(2)


def test_scans_received_during_deactivation_are_not_published_later(tmp_path: Path) -> None:
    with driven(tmp_path) as it:
        driver = it.component.runtime.component
        assert isinstance(driver, HokuyoScanner)
        it.scans.wait(1)
        sensor = driver._measurement.sensor
        assert sensor is not None
        last = StampedScan(ScanData(0, np.zeros((1, 1), np.int32)), ScanRequest(0, 0), sensor, 0)
        for _ in range(3):
            it.scans.wait(3, after=len(it.scans))
            it.component.ask("deactivate")
            driver._feed.put(last)
            it.component.ask("activate")
        it.scans.wait(3, after=len(it.scans))

    assert_all_were_sent(it)


def test_parameters_are_checked_while_unplugged_too(tmp_path: Path) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(1)
        it.emulator.unplug()
        it.health(lambda status: status.level == ERROR)
        with pytest.raises(CairnError, match="no two rays"):
            it.component.ask("set_parameters", {"angle_min": 2.4, "angle_max": 2.5})
        it.component.ask("set_parameters", {"angle_min": 0.0})
        before = len(it.scans)
        it.emulator.plug_in()
        assert it.scans.wait(1, after=before)[0].angle_min == pytest.approx(0.0, abs=0.01)


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


def test_the_driver_stops_while_it_searches_for_a_sensor(tmp_path: Path) -> None:
    port = tmp_path / "scanner"
    device = SilentDevice()
    with Emulator(device, PtyEnd(port)) as emulator:
        it = Driven(emulator, device, [], restarts=1, port=str(port))
        try:
            emulator.unplug()
            it.component.ask("configure")
            emulator.plug_in()
            it.component.ask("activate")
            assert device.is_searched.wait(LIMIT_S)
            it.component.ask("deactivate")  # all speeds would take longer than this may
            it.component.ask("cleanup")
        finally:
            it.component.close()


def test_a_sensor_that_does_not_stop_is_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.hang()
        it.component.ask("deactivate")
        it.emulator.hang(0.0)

    assert "its laser may still be on" in caplog.text
