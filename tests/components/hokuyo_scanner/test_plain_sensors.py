"""Sensors with only the necessary commands of SCIP are supported."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from cairn import to_ns
from cairn.components.hokuyo_scanner.protocol import encode_number, with_sum
from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import PtyEnd
from cairn.schemas.sensor_msgs import LaserScan
from tests.components.hokuyo_scanner.emulated_driver import EmulatedDriver

pytestmark = pytest.mark.slow


_LIMITS = ("DMIN:100", "DMAX:4000", "SCAN:600")
_STEPS = ("ARES:360", "AMIN:0", "AMAX:180", "AFRT:90")
_PP = ("MODL:PLAIN-1", *_LIMITS, *_STEPS, "EXTRA:new")


class PlainSensor:
    """Answers QT, PP and MD, and no other command. Its clock stands still."""

    def __init__(self, *, wants_laser: bool) -> None:
        self._wants_laser = wants_laser
        self._laser = False
        self._echo: bytes | None = None
        self._due = math.inf
        self._number = 0

    def receive(self, data: bytes, now: float) -> list[bytes]:
        return [answer for line in data.split(b"\n") if (answer := self._answer(line, now))]

    def _answer(self, line: bytes, now: float) -> bytes:
        match line[:2]:
            case b"QT":
                self._echo, self._due = None, math.inf
                return b"QT\n00P\n\n"
            case b"PP":
                lines = [f"{one};".encode() + with_sum(one.encode())[-1:] for one in _PP]
                return b"\n".join([b"PP", b"00P", *lines, b"", b""])
            case b"BM" if self._wants_laser:
                self._laser = True
                return b"BM\n00P\n\n"
            case b"MD" if self._wants_laser and not self._laser:
                return line + b"\n10Q\n\n"
            case b"MD":
                self._echo, self._due = line, now + 0.1
                return line + b"\n00P\n\n"
        return b""

    def due(self) -> float:
        return self._due

    def tick(self, now: float) -> list[bytes]:
        if self._echo is None or now < self._due:
            return []
        self._due += 0.1
        self._number += 1
        values = np.full(181, 1000 + self._number)
        text = b"".join(encode_number(int(value), 3) for value in values)
        lines = [with_sum(text[at : at + 64]) for at in range(0, len(text), 64)]
        return [b"\n".join([self._echo, b"99b", with_sum(b"0000"), *lines, b"", b""])]

    def disconnected(self, now: float) -> None:
        """Ignore it."""

    def powered_on(self, now: float) -> None:
        """Keep its state."""

    def baud(self) -> int | None:
        return None


def stamp_of(scan: LaserScan) -> int:
    return to_ns(scan.header.stamp)


@pytest.mark.parametrize("wants_laser", [False, True])
def test_sensor_with_only_the_mandatory_commands_works(tmp_path: Path, wants_laser: bool) -> None:
    port = tmp_path / "scanner"
    with Emulator(PlainSensor(wants_laser=wants_laser), PtyEnd(port)) as emulator:
        # Restarted: a late reply does not fail configuration.
        setup = EmulatedDriver(emulator, None, [], restarts=1, port=str(port))
        try:
            setup.component.activate()
            # Scans that are read at once have the same stamp.
            scans = setup.scans.wait_for(
                lambda scans: len(scans) >= 5 and stamp_of(scans[-1]) > stamp_of(scans[0])
            )
            # On a busy computer, the driver may just be reconnecting.
            report = setup.health(lambda status: any(one.key == "model" for one in status.values))
        finally:
            setup.component.close()

    # A busy computer may drop some.
    numbers = [1000.0 * (float(scan.ranges[0]) - 1.0) for scan in scans]
    assert numbers == pytest.approx([round(number) for number in numbers], abs=1e-3)
    assert numbers[0] > 0.5
    assert np.all(np.diff(numbers) > 0.5)
    assert scans[0].angle_min == pytest.approx(-math.pi / 2)
    assert scans[0].ranges.size == 181
    # Equal times become system time one after the other, which is exact to microseconds.
    assert np.all(np.diff([stamp_of(scan) for scan in scans]) > -1_000_000)
    values = {value.key: value.value for value in report.values}
    assert values["model"] == "PLAIN-1"
    assert values["computing [ms]"] == "not measured"
