"""Whatever happens on the line: no wrong scan is published, and soon there are scans again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.hokuyo.component import HokuyoScanner
from cairn.components.hokuyo.emulated_record import SentScan
from cairn.components.hokuyo.emulated_scip import EmulatedScip
from cairn.components.hokuyo.measurement import Measured
from cairn.components.hokuyo.replies import ReplySplitter
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scan_data import ScanData
from cairn.components.hokuyo.stream import ScanStream
from cairn.driver.diagnostics import ERROR, OK, WARN
from cairn.driver.emulator import FrameFault, FrameFaults
from tests.components.hokuyo.comparing import assert_were_sent
from tests.components.hokuyo.driving import Driven, driven

FAULTS: tuple[FrameFault, ...] = ("bad_sum", "cut", "garbage", "drop")

_ANY_RATE = 1.0  # how many scans a busy machine leaves is not judged here


def assert_all_were_sent(it: Driven) -> None:
    """Every scan that was published is one that was sent, and none came twice."""
    assert_were_sent(it.scans.all(), it.sent, "UTM-30LX")


def values(status: Any) -> dict[str, str]:
    """What a status tells beside its message."""
    return {value.key: value.value for value in status.values}


def test_of_a_thousand_faults_none_makes_a_wrong_scan() -> None:
    faults = FrameFaults(dict.fromkeys(FAULTS, 0.2), np.random.default_rng(3))
    sent: list[SentScan] = []
    device = EmulatedScip("UTM-30LX", on_scan=sent.append)
    request = ScanRequest(0, 1080)
    device.receive(request.command + b"\n", 0.0)
    splitter, stream, now, taken = ReplySplitter(), ScanStream(), 0.0, 0
    while faults.counts.total() < 1000:
        now += 0.025
        bytes_ = b"".join(map(faults.apply, device.tick(now)))
        for reply in splitter.feed(bytes_):
            data = stream.take(reply, request, scip2=True)
            if data is not None:
                (one,) = [scan for scan in sent[-3:] if scan.time_ms == data.time_ms]
                assert np.array_equal(data.distances[:, 0], one.distances[:, 0])
                taken += 1

    assert set(faults.counts) == set(FAULTS)
    assert taken == stream.good >= 0.3 * len(sent)


@pytest.mark.parametrize("tcp", [False, True])
def test_after_faults_of_all_kinds_scans_come_again(tmp_path: Path, tcp: bool) -> None:
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
def test_a_spoilt_scan_is_left_out_and_counted(tmp_path: Path, fault: FrameFault) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.inject(fault, 3)
        it.scans.wait(10, after=len(it.scans))
        told = it.health(lambda status: True)

    assert_all_were_sent(it)
    assert it.emulator.injected == {fault: 3}
    assert values(told)["connections"] == "1"
    if fault in ("bad_sum", "cut"):
        assert int(values(told)["damaged replies"]) + int(values(told)["bytes of no reply"]) >= 1


def test_a_sensor_that_falls_silent_is_begun_anew(tmp_path: Path) -> None:
    with driven(tmp_path, silence_s=0.2) as it:
        it.scans.wait(2)
        it.emulator.call(lambda: it.device.receive(b"QT\n", 0.0))  # as if it had stopped by itself
        it.scans.wait(3, after=len(it.scans))
        told = it.health(lambda status: "silent" in status.message)

    assert told.level == WARN


def test_a_sensor_that_hangs_comes_back(tmp_path: Path) -> None:
    with driven(tmp_path, silence_s=0.1, rate_tolerance=_ANY_RATE) as it:
        it.scans.wait(2)
        it.emulator.hang()
        trouble = it.health(lambda status: status.level == ERROR)
        before = len(it.scans)
        it.emulator.hang(0.0)
        it.scans.wait(3, after=before)
        it.health(lambda status: status.level == OK)

    assert "scanner" in trouble.message
    assert_all_were_sent(it)


@pytest.mark.parametrize("tcp", [False, True])
def test_unplugged_and_plugged_in_again(tmp_path: Path, tcp: bool) -> None:
    with driven(tmp_path, tcp=tcp, rate_tolerance=_ANY_RATE) as it:
        it.scans.wait(2)
        it.emulator.unplug()
        trouble = it.health(lambda status: status.level == ERROR)
        before = len(it.scans)
        it.emulator.plug_in()
        it.scans.wait(3, after=before)
        it.health(lambda status: status.level == OK)

    assert "cannot be" in trouble.message or "gone" in trouble.message
    assert_all_were_sent(it)


def test_unplugged_while_it_rests(tmp_path: Path) -> None:
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
def test_statuses_in_a_stream_are_no_faults_of_the_line(tmp_path: Path, status: str) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.call(lambda: it.device.trouble(status, 2))
        it.scans.wait(5, after=len(it.scans))
        told = it.health(lambda told: values(told).get(f"status {status}") == "2")

    assert values(told)["damaged replies"] == "0"


def test_a_sensor_that_says_that_it_is_broken_is_told_of(tmp_path: Path) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.call(lambda: it.device.trouble("55"))
        told = it.health(lambda status: status.level == ERROR)

    assert "55" in told.message


def test_a_driver_that_is_restarted_waits_for_its_sensor(tmp_path: Path) -> None:
    with driven(tmp_path, activate=False, restarts=1) as it:
        it.emulator.unplug()
        it.component.activate()
        it.health(lambda status: status.level == ERROR)
        it.emulator.plug_in()
        it.scans.wait(2)


def test_what_came_while_it_was_deactivated_is_not_told_afterwards(tmp_path: Path) -> None:
    with driven(tmp_path) as it:
        driver = it.component.runtime.component
        assert isinstance(driver, HokuyoScanner)
        it.scans.wait(1)
        sensor = driver._measurement.sensor
        assert sensor is not None
        last = Measured(ScanData(0, np.zeros((1, 1), np.int32)), ScanRequest(0, 0), sensor, 0)
        for _ in range(3):
            it.scans.wait(3, after=len(it.scans))
            it.component.ask("deactivate")
            driver._feed.put(last)
            it.component.ask("activate")
        it.scans.wait(3, after=len(it.scans))

    assert_all_were_sent(it)


def test_parameters_are_judged_while_it_is_unplugged_too(tmp_path: Path) -> None:
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


def test_it_stops_while_it_looks_for_a_sensor(tmp_path: Path) -> None:
    with driven(tmp_path, activate=False, restarts=1) as it:
        it.emulator.hang()
        it.component.activate()
        it.health(lambda status: status.level == ERROR)
        it.component.ask("deactivate")
        it.component.ask("cleanup")


def test_a_sensor_that_cannot_be_told_to_rest_is_told_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with driven(tmp_path) as it:
        it.scans.wait(2)
        it.emulator.hang()
        it.component.ask("deactivate")
        it.emulator.hang(0.0)

    assert "its laser may still be on" in caplog.text
