"""`cairn driver probe hokuyo` identifies a scanner, and draws its scans."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from serial.tools import list_ports

from cairn.components.hokuyo_scanner import probe_cli
from cairn.components.hokuyo_scanner.config import HokuyoConfig
from cairn.components.hokuyo_scanner.emulator import EmulatedScip
from cairn.components.hokuyo_scanner.probe_cli import draw_scan
from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import PtyEnd, TcpEnd
from cairn.schemas.sensor_msgs import LaserScan
from tests.commands import cairn
from tests.patience import LIMIT_S


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Await replies and scans however long a busy computer takes."""
    monkeypatch.setattr("cairn.components.hokuyo_scanner.client._REPLY_TIMEOUT_S", LIMIT_S)
    monkeypatch.setattr(probe_cli, "_FIRST_SCAN_S", LIMIT_S)
    config = probe_cli._config

    def patient_config(device: str, baud: int, intensity: bool) -> HokuyoConfig:
        return config(device, baud, intensity).model_copy(update={"silence_s": LIMIT_S})

    monkeypatch.setattr(probe_cli, "_config", patient_config)


@pytest.fixture
def port(tmp_path: Path) -> Iterator[str]:
    with Emulator(EmulatedScip("UST-20LX"), PtyEnd(tmp_path / "scanner")):
        yield str(tmp_path / "scanner")


@pytest.mark.usefixtures("patience")
def test_model_and_rate_are_printed(port: str) -> None:
    answer = cairn("driver", "probe", "hokuyo", port, "--seconds", "0.5")

    assert answer.code == 0, answer.err
    assert "UST-20LX" in answer.out
    assert "nominal: 40.00" in answer.out


@pytest.mark.usefixtures("patience")
def test_probe_prints_json_over_tcp() -> None:
    end = TcpEnd(0)
    with Emulator(EmulatedScip("UTM-30LX-EW"), end):
        where = f"tcp:127.0.0.1:{end.port}"
        answer = cairn("driver", "probe", "hokuyo", where, "--seconds", "0.3", "--json")

    assert answer.code == 0, answer.err
    assert answer.json["model"].startswith("UTM-30LX-EW")
    assert answer.json["nominal rate [Hz]"] == 40.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["/dev/nothing"], "/dev/nothing cannot be opened: No such file or directory"),
        (["tcp:127.0.0.1:99999"], "tcp_port = '99999': should be less than or equal to 65535"),
        (["/dev/ttyACM0", "--baud", "1200"], "baud = 1200: should be greater"),
        (["usb:15d1:0042"], "usb:15d1:0042: no such device is plugged in"),
    ],
)
def test_errors_name_the_device_or_value(words: list[str], message: str) -> None:
    answer = cairn("driver", "probe", "hokuyo", *words)

    assert answer.code == 1
    assert message in answer.err


def test_probe_without_a_port_lists_the_serial_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_ports, "comports", list)

    assert "no serial port found" in cairn("driver", "probe", "hokuyo").out


def scan_of(ranges: Any, first: float, step: float) -> LaserScan:
    array = np.array(ranges, np.float32)
    last = first + step * (array.size - 1)
    return LaserScan(
        angle_min=first, angle_max=last, angle_increment=step, range_max=10.0, ranges=array
    )


def test_picture_shows_forward_up_and_left_on_the_left() -> None:
    # Ahead 2 m, left 4 m, behind nothing, right 1 m.
    scan = scan_of([1.0, 2.0, 4.0, math.inf], -0.5 * math.pi, 0.5 * math.pi)

    picture, reach = draw_scan(scan, (21, 11), 4.0)

    lines = picture.split("\n")
    assert reach == 4.0
    assert len(lines) == 11
    assert {len(line) for line in lines} == {21}
    assert lines[5][10] == "+"
    dots = {
        (row, column) for row, line in enumerate(lines) for column, text in enumerate(line)
        if text not in "+\u2800"
    }  # fmt: skip
    assert len(dots) == 3
    assert any(row in (2, 3) and column == 10 for row, column in dots)  # ahead
    assert any(row in (5, 6) and column < 1 for row, column in dots)  # left
    assert any(row in (5, 6) and 12 <= column <= 13 for row, column in dots)  # right


def test_picture_reaches_nearly_all_ranges() -> None:
    scan = scan_of([2.0] * 99 + [9.0], 0.0, 0.01)
    nothing = scan_of([math.inf] * 10, 0.0, 0.01)

    assert draw_scan(scan, (40, 20))[1] == pytest.approx(2.1, abs=0.02)
    assert draw_scan(nothing, (40, 20))[1] == 10.0
