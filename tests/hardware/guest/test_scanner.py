"""The SCIP driver on the kernel's own drivers: USB-CDC and RS-232 behind an FTDI adapter."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cairn.driver.diagnostics import ERROR, OK
from cairn.driver.emulator_lines import SerialEnd
from tests.components.hokuyo_scanner.emulated_driver import (
    REPLY_TIMEOUT_S,
    EmulatedDriver,
    assert_were_sent,
    emulated_driver,
)
from tests.hardware.guest.cables import Cable

_SPEED = 115200
_SCANS = 8


@contextmanager
def scanner(cable: Cable, model: str, **parameters: Any) -> Iterator[EmulatedDriver]:
    """Run the driver on the stable name of a cable, with a sensor at its far end."""
    end = SerialEnd(str(cable.far_end), _SPEED)
    name = str(cable.stable)
    # A real line may lose commands while it is plugged in.
    parameters = {"silence_s": 2.0, "reply_timeout_s": REPLY_TIMEOUT_S} | parameters
    with emulated_driver(Path("/nowhere"), model, cable=(end, name), **parameters) as setup:
        yield setup


@pytest.mark.parametrize(
    ("line", "model", "parameters"),
    [
        # Emulated processors are slow: they follow only a few of 40 scans per second.
        ("acm", "UTM-30LX", {"skip": 9}),
        ("acm", "UTM-30LX", {"skip": 9, "intensity": True, "cluster": 2}),
        ("acm", "URG-04LX", {"skip": 1, "short_distances": True}),
        ("ftdi", "URG-04LX", {"skip": 1, "cluster": 3}),
        ("ftdi", "URG-04LX", {"skip": 1, "emulated": {"speaks_scip1": True}, "angle_min": 0.0}),
    ],
)
def test_every_scan_is_equal_to_what_was_sent(
    request: pytest.FixtureRequest, line: str, model: str, parameters: dict[str, Any]
) -> None:
    with scanner(request.getfixturevalue(line), model, **parameters) as setup:
        scans = setup.scans.wait(_SCANS)
    short = bool(parameters.get("short_distances"))

    assert_were_sent(scans, setup.sent, model, short=short)


@pytest.mark.parametrize("line", ["acm", "ftdi"])
def test_scans_resume_after_unplugging(
    request: pytest.FixtureRequest, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cable: Cable = request.getfixturevalue(line)
    with scanner(cable, "URG-04LX", cluster=3, skip=1) as setup:
        setup.scans.wait(3)
        cable.unplug()
        report = setup.health(lambda status: status.level == ERROR)
        setup.emulator.unplug()
        before = len(setup.scans)
        cable.plug_in()
        setup.emulator.plug_in()
        returned = time.monotonic()
        setup.scans.wait(1, after=before)
        took_s = time.monotonic() - returned
        setup.health(lambda status: status.level == OK)

    with capsys.disabled():
        print(f" publishing {took_s:.2f} s after {cable.port} was back ", end="")
    assert str(cable.stable) in report.message


def test_scanner_that_returns_under_another_name_is_found(acm: Cable) -> None:
    end = SerialEnd(str(acm.far_end), _SPEED)
    name = "usb:15d1:0000:H0000001"
    with emulated_driver(
        Path("/nowhere"), "URG-04LX", cable=(end, name), skip=1, silence_s=2.0,
        reply_timeout_s=REPLY_TIMEOUT_S,
    ) as setup:  # fmt: skip
        setup.scans.wait(3)
        acm.unplug()
        setup.emulator.unplug()
        before = len(setup.scans)
        acm.plug_in()
        setup.emulator.plug_in()
        setup.scans.wait(3, after=before)
