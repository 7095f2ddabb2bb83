"""The driver publishes exactly what the sensor sent, in every mode, over serial lines and TCP."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import CairnError
from cairn.components.hokuyo_scanner.config import HokuyoConfig
from cairn.components.hokuyo_scanner.emulator_sensor import SentScan
from cairn.components.hokuyo_scanner.sensor import connect
from cairn.driver.errors import DeviceError
from cairn.driver.serial_and_tcp import SerialLink
from tests.components.hokuyo_scanner.emulated_driver import (
    REPLY_TIMEOUT_S,
    EmulatedDriver,
    Received,
    assert_were_sent,
    emulated_driver,
    ranges,
)
from tests.patience import LIMIT_S
from tests.wording import words_in_order

pytestmark = pytest.mark.slow


SCANS = 8
URG, UTM, EW, UST = "URG-04LX", "UTM-30LX", "UTM-30LX-EW", "UST-10LX"
MODES: list[tuple[str, bool, dict[str, Any], dict[str, Any]]] = [
    (UTM, False, {}, {}),
    (UTM, True, {}, {}),
    (UTM, False, {"intensity": True}, {}),
    (UTM, False, {"cluster": 3, "skip": 1}, {}),
    (UTM, False, {"angle_min": -1.0, "angle_max": 0.5}, {}),
    (URG, False, {"short_distances": True}, {}),
    (URG, False, {"cluster": 4}, {"speaks_scip1": True}),
    (URG, False, {"angle_min": -1.0}, {"speaks_scip1": True, "knows_scip2": False}),
    (EW, True, {"multi_echo": True, "skip": 3}, {}),
    (EW, True, {"multi_echo": True, "intensity": True, "echo": "strongest", "skip": 3}, {}),
    (UST, True, {"intensity": True}, {"clock_start_ms": 2**24 - 60}),
]


@pytest.mark.parametrize(("model", "tcp", "parameters", "emulated"), MODES)
def test_every_scan_is_equal_to_what_was_sent(
    tmp_path: Path,
    model: str,
    tcp: bool,
    parameters: dict[str, Any],
    emulated: dict[str, Any],
) -> None:
    has_clock = emulated.get("knows_scip2", True)  # else it sends its last scan whenever asked
    short = bool(parameters.get("short_distances")) or not has_clock
    echo = parameters.get("echo", "first")
    with emulated_driver(tmp_path, model, tcp=tcp, emulated=emulated, **parameters) as setup:
        scans = setup.scans.wait(SCANS)
        multi = setup.multi.wait(SCANS) if parameters.get("multi_echo") else []
        sent = assert_were_sent(scans, setup.sent, model, echo=echo, short=short)
        if has_clock:
            await_stamps_by_turns(setup, model, echo=echo, short=short)

    for one in sent:
        assert (one.intensities is not None) == bool(parameters.get("intensity"))
    for scan in multi:
        (one,) = [
            one for one, first in zip(sent, scans, strict=True) if first.header == scan.header
        ]
        report = [ranges(row[row >= 0], model) for row in one.distances]
        for echoes, expected in zip(scan.ranges, report, strict=True):
            assert echoes.echoes.tolist() == pytest.approx(expected, abs=1e-5, nan_ok=True)
        assert len(scan.intensities) == (len(report) if parameters.get("intensity") else 0)


def await_stamps_by_turns(setup: EmulatedDriver, model: str, *, echo: str, short: bool) -> None:
    """Wait for scans whose stamps are as far apart as their turns.

    As long as each scan arrives earlier after its turn than all before, stamps approach the truth.
    """
    deadline, after = time.monotonic() + LIMIT_S, 0
    while True:
        scans = setup.scans.wait(SCANS, after=after)
        sent = assert_were_sent(scans, setup.sent, model, echo=echo, short=short)
        off = np.abs(np.diff([_seconds(scan) for scan in scans]) - _times_between(sent, model))
        if np.median(off) <= 0.004:
            return
        assert time.monotonic() < deadline, f"stamps are off by {off} s from turns"
        after += SCANS


def _times_between(sent: Sequence[SentScan], model: str) -> Any:
    return np.diff([one.turn for one in sent]) * _turn_s(model)


def _turn_s(model: str) -> float:
    return 0.1 if model.startswith("URG") else 0.025


def _seconds(scan: Any) -> float:
    return float(scan.header.stamp.sec + scan.header.stamp.nanosec * 1e-9)


def test_angles_and_diagnostics_describe_the_sensor(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, UTM, frame_id="front_laser") as setup:
        scan = setup.scans.wait(3)[0]
        report = setup.health(lambda status: True)
    values = {value.key: value.value for value in report.values}

    assert scan.header.frame_id == "front_laser"
    assert scan.ranges.size == 1081
    assert scan.angle_min == pytest.approx(-0.75 * math.pi, abs=1e-6)
    assert scan.angle_max == pytest.approx(0.75 * math.pi, abs=1e-6)
    assert report.hardware_id == "H0614967"
    assert values["nominal rate [Hz]"] == "40"
    assert values["firmware"].startswith("1.18")
    assert values["STAT at start"] == "Sensor works well."


def test_laser_is_on_only_while_the_driver_is_active(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, activate=False) as setup:
        setup.component.request("configure")
        assert not setup.sent
        setup.component.request("activate")
        setup.scans.wait(2)
        setup.component.request("deactivate")
        sent = len(setup.sent)
        lasers: list[bool] = []
        setup.emulator.call(lambda: lasers.append(_laser(setup)))
        assert lasers == [False]
        setup.component.request("activate")
        setup.scans.wait(2, after=len(setup.scans))
        setup.component.request("deactivate")
        setup.component.request("cleanup")
        setup.component.request("configure")
        setup.component.request("activate")
        setup.scans.wait(2, after=len(setup.scans))

    assert len(setup.sent) > sent


def _laser(setup: EmulatedDriver) -> bool:
    return bool(setup.device.sensor.laser)


def test_parameters_change_while_it_runs_or_are_rejected(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, UTM) as setup:
        setup.scans.wait(2)
        setup.component.set_parameters({"cluster": 5, "angle_min": 0.0, "skip": 1})
        setup.scans.wait_for(lambda scans: scans[-1].ranges.size == 109)
        changed = setup.scans.all()[-1]
        for change, reason in (
            ({"port": "/dev/elsewhere"}, "port cannot change while"),
            ({"angle_min": 2.4, "angle_max": 2.5}, "no two rays of a UTM-30LX"),
            ({"cluster": 0}, "cluster = 0 rejected"),
            ({"angle_min": 3.0, "angle_max": 2.0}, "angle_min must be less"),
        ):
            with pytest.raises(CairnError, match=reason):
                setup.component.set_parameters(change)
        size = setup.scans.wait(3, after=len(setup.scans))[-1].ranges.size

    assert changed.angle_min == pytest.approx(0.0, abs=1e-6)
    assert changed.scan_time == pytest.approx(0.05)
    assert size == 109


def test_options_that_a_sensor_lacks_are_dropped_and_reported(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, "URG-04LX-UG01", intensity=True, multi_echo=True) as setup:
        scan = setup.scans.wait(1)[0]
        report = setup.health(lambda status: True)
    values = {value.key: value.value for value in report.values}

    assert scan.intensities.size == 0
    assert values["intensity"] == "False"
    assert values["multi-echo"] == "False"


@pytest.mark.parametrize("baud", [19200, 500000])
def test_line_speed_is_found_and_changed(tmp_path: Path, baud: int) -> None:
    with emulated_driver(
        tmp_path, URG, emulated={"rs232_baud": baud}, baud=115200, cluster=9,
        reply_timeout_s=REPLY_TIMEOUT_S, restarts=1,
    ) as setup:  # fmt: skip
        setup.scans.wait(2)
        assert setup.device.baud() == 115200


def test_sensor_left_streaming_by_a_crashed_program_is_taken_over(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, UTM, activate=False) as setup:
        crashed = SerialLink(str(tmp_path / "scanner"), 115200)
        crashed.write(b"ME0000108001000\n")
        assert crashed.read(LIMIT_S)
        crashed.close()
        setup.component.activate()
        setup.scans.wait(3)

    assert setup.scans.all()[0].ranges.size == 1081
    assert setup.scans.all()[0].intensities.size == 0


def test_missing_sensor_is_an_error_with_its_address(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, activate=False) as setup:
        setup.emulator.unplug()
        with pytest.raises(CairnError, match=r"scanner cannot be opened: No such file"):
            setup.component.request("configure")
    with emulated_driver(tmp_path, activate=False, tcp=True) as setup:
        setup.emulator.unplug()
        with pytest.raises(CairnError, match=r"127.0.0.1:\d+ cannot be connected: Connection ref"):
            setup.component.request("configure")


def test_silent_device_is_an_error(tmp_path: Path) -> None:
    with emulated_driver(
        tmp_path, activate=False, tcp=True, reply_timeout_s=REPLY_TIMEOUT_S
    ) as setup:
        setup.emulator.hang()
        with pytest.raises(CairnError, match=words_in_order("SCIP sensor")):
            setup.component.request("configure")


class EchoLine:
    """A line to a device that repeats what it receives; time passes while nothing is received."""

    name = "parrot"
    paced = False

    def __init__(self) -> None:
        self._now = 0.0
        self._received = b""

    def monotonic(self) -> float:
        return self._now

    def monotonic_ns(self) -> int:
        return round(1e9 * self._now)

    def read(self, timeout_s: float) -> bytes:
        received, self._received = self._received, b""
        if not received:
            self._now += timeout_s
        return received

    def write(self, data: bytes) -> None:
        self._received += data

    def set_baud(self, baud: int) -> None:
        pass

    def discard(self) -> None:
        self._received = b""

    def close(self) -> None:
        pass


def test_bytes_of_another_device_are_in_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    line = EchoLine()
    monkeypatch.setattr("cairn.components.hokuyo_scanner.sensor.SerialLink", lambda *_: line)
    monkeypatch.setattr("cairn.components.hokuyo_scanner.client.time", line)

    with pytest.raises(DeviceError, match=r"parrot: nothing .* .* is not SCIP: b'.*QT"):
        connect(HokuyoConfig(port="/dev/parrot"), bauds=(115200,))


def test_slow_line_is_not_treated_as_silent(tmp_path: Path) -> None:
    slow: dict[str, Any] = {"emulated": {"rs232_baud": 19200}, "line": {"paced": True}}
    with emulated_driver(tmp_path, URG, baud=19200, cluster=4, silence_s=0.05, **slow) as setup:
        # Each takes 0.28 s on the line. The sensor is started again if the computer pauses.
        setup.diagnostics.wait_for(lambda messages: scans_without_restart(messages) >= 3)


def scans_without_restart(messages: Sequence[Any]) -> int:
    """Return how many scans arrived between two restarts of the sensor, at most."""
    scans = defaultdict[tuple[str, str], list[int]](list)
    for message in messages:
        values = {value.key: value.value for value in message.status[0].values}
        run = values["connections"], values["restarts after silence"]
        scans[run].append(int(values["scans"]))
    return max((max(counts) - min(counts) for counts in scans.values()), default=0)


def test_angles_without_rays_fail_configuration(tmp_path: Path) -> None:
    with (
        emulated_driver(tmp_path, activate=False, angle_min=2.4, angle_max=2.5) as setup,
        pytest.raises(CairnError, match=words_in_order("-2.356", "2.356 rad")),
    ):
        setup.component.request("configure")


def test_waiting_for_messages_has_a_limit(tmp_path: Path) -> None:
    with emulated_driver(tmp_path, activate=False) as setup:
        assert isinstance(setup.scans, Received)
        with pytest.raises(AssertionError, match="only 0 received"):
            setup.scans.wait_for(lambda scans: bool(scans), limit_s=0.01)
