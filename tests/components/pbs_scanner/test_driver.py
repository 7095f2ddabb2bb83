"""The driver of the PBS-03JN at one end of a serial line, an emulated sensor at the other."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import SECOND, CairnError, every, to_ns
from cairn.bus.control import ControlError
from cairn.bus.lockstep_bus import LockstepBus
from cairn.components.pbs_scanner.component import PbsScanner
from cairn.components.pbs_scanner.emulator import EmulatedPbs, SentDistances
from cairn.components.pbs_scanner.protocol import (
    BAUD,
    DISTANCES,
    LINK_CODE,
    FrameSplitter,
    encode_frame,
    parse_distances,
    parse_link_code,
)
from cairn.driver.emulator import FRAME_FAULTS, Emulator
from cairn.driver.emulator_lines import PtyEnd
from cairn.driver.serial_and_tcp import SerialLink
from cairn.schemas.diagnostic_msgs import DiagnosticArray, DiagnosticStatus
from cairn.schemas.sensor_msgs import LaserScan
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.components.hokuyo_scanner.emulated_driver import Received
from tests.patience import LIMIT_S

pytestmark = pytest.mark.slow


class FrequentReporter(PbsScanner):
    """Reports 20 times per second, so that tests wait less for diagnostics."""

    @every(hz=20)
    def report(self) -> None:
        super().report()


@dataclass
class EmulatedDriver:
    """A driver and the emulated sensor that it reads."""

    emulator: Emulator
    sent: list[SentDistances]
    component: ThreadedComponent
    scans: Received
    diagnostics: Received


@contextmanager
def _emulated_driver(
    folder: Path, *, activate: bool = True, replies: bool = True, **line: Any
) -> Iterator[EmulatedDriver]:
    """Run driver and sensor; one that `replies` is not given up, however busy the computer."""
    sent: list[SentDistances] = []
    device = EmulatedPbs(on_scan=sent.append)
    bus = LockstepBus()
    received = (Received(bus, "scan", LaserScan), Received(bus, "diagnostics", DiagnosticArray))
    with (
        pytest.MonkeyPatch.context() as patch,
        Emulator(device, PtyEnd(folder / "scanner"), **line) as emulator,
    ):
        if replies:
            patch.setattr("cairn.components.pbs_scanner.sensor._CONNECT_TIMEOUT_S", LIMIT_S)
            patch.setattr("cairn.components.pbs_scanner.protocol._SILENT_REQUESTS", 1000)
        parameters = {"port": str(folder / "scanner")}
        component = ThreadedComponent(FrequentReporter, bus, parameters=parameters)
        try:
            if activate:
                component.activate()
            yield EmulatedDriver(emulator, sent, component, *received)
        finally:
            component.close()


def _millimeters(scan: LaserScan) -> list[int]:
    """Distances as they were sent, and 0 where they are out of the scanner's range."""
    meters = np.where(np.isfinite(scan.ranges), scan.ranges, 0.0)
    return [round(1000.0 * one) for one in meters.tolist()]


def _stamp(scan: LaserScan) -> int:
    return to_ns(scan.header.stamp)


def _in_range(sent: SentDistances) -> list[int]:
    return [one if 200 <= one <= 3000 else 0 for one in sent.distances.tolist()]


def test_every_scan_is_equal_to_what_was_sent(tmp_path: Path) -> None:
    before = time.time_ns() - SECOND  # the sensor sends its last turn
    with _emulated_driver(tmp_path) as driver:
        # Late replies that arrive together have the same stamp.
        scans = driver.scans.wait_for(
            lambda scans: len(scans) >= 5 and _stamp(scans[-1]) > _stamp(scans[0])
        )
        now = time.time_ns()
    sent = map(_in_range, driver.sent)
    for scan in scans:  # a busy computer may drop some of those sent
        assert _millimeters(scan) in sent, "a scan was not sent, or not in this order"
    stamps = [before, *map(_stamp, scans), now]
    # Equal times become system time one after the other, which is exact to microseconds.
    assert all(later - sooner > -1_000_000 for sooner, later in pairwise(stamps))
    assert {scan.header.frame_id for scan in scans} == {"laser"}
    assert math.isclose(scans[0].angle_increment, math.radians(1.8), rel_tol=1e-6)


def test_damaged_frames_are_counted_in_the_diagnostics(tmp_path: Path) -> None:
    with _emulated_driver(tmp_path, paced=True) as driver:
        driver.scans.wait(1)
        driver.emulator.inject("bad_sum", 2)
        reports = driver.diagnostics.wait_for(
            lambda all_: any("damaged" in one.status[0].message for one in all_)
        )
    status: DiagnosticStatus = next(
        one.status[0] for one in reports if "damaged" in one.status[0].message
    )
    values = {pair.key: pair.value for pair in status.values}
    assert status.level == DiagnosticStatus.WARN
    assert values["port"] == str(tmp_path / "scanner")
    assert int(values["damaged frames"]) >= 1


def test_line_faults_cause_no_wrong_scan(tmp_path: Path) -> None:
    shares = dict.fromkeys(FRAME_FAULTS, 0.1)
    with _emulated_driver(tmp_path, shares=shares, seed=3) as driver:
        scans = driver.scans.wait(10)
    sent = [_in_range(one) for one in driver.sent]
    assert all(_millimeters(scan) in sent for scan in scans)


def test_scans_resume_after_unplugging(tmp_path: Path) -> None:
    with _emulated_driver(tmp_path) as driver:
        driver.scans.wait(2)
        driver.emulator.unplug()
        driver.diagnostics.wait_for(
            lambda all_: bool(all_) and all_[-1].status[0].level == DiagnosticStatus.ERROR
        )
        before = len(driver.scans)
        driver.emulator.plug_in()
        driver.scans.wait(3, after=before)


def test_deactivation_releases_port_and_link(tmp_path: Path) -> None:
    with _emulated_driver(tmp_path) as driver:
        driver.scans.wait(2)
        driver.component.request("deactivate")
        # Neither the port nor the link is held.
        line = SerialLink(str(tmp_path / "scanner"), BAUD)
        _answers_until_link_code(line, LINK_CODE)  # those to the driver's last requests
        answers = _answers_until_link_code(line, DISTANCES, LINK_CODE)
        assert all(parse_distances(answer) is None for answer in answers)
        line.close()
        before = len(driver.scans)
        driver.component.request("activate")
        driver.scans.wait(2, after=before)


def _answers_until_link_code(line: SerialLink, *requests: bytes) -> list[bytes]:
    for payload in requests:
        line.write(encode_frame(payload))
    splitter = FrameSplitter()
    answers: list[bytes] = []
    while not any(map(parse_link_code, answers)):
        answers += splitter.feed(line.read(LIMIT_S))
    return answers


def test_missing_port_fails_configuration(tmp_path: Path) -> None:
    with _emulated_driver(tmp_path, activate=False) as driver:
        driver.emulator.unplug()
        with pytest.raises((CairnError, ControlError), match="scanner cannot be opened"):
            driver.component.request("configure")


def test_silent_line_fails_configuration(tmp_path: Path) -> None:
    with _emulated_driver(tmp_path, activate=False, replies=False) as driver:
        driver.emulator.hang()
        with pytest.raises((CairnError, ControlError), match="no PBS-03JN replies"):
            driver.component.request("configure")
