"""The rules of deploy/robot give a robot's devices their names, rights and settings."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hardware.guest.cables import Cable
from tests.hardware.guest.modules import run

_RULES = Path(__file__).parents[3] / "deploy" / "robot" / "70-cairn.rules"
_INSTALLED = Path("/run/udev/rules.d")


@pytest.fixture(autouse=True)
def _rules() -> Iterator[None]:
    """The rules, installed."""
    _INSTALLED.mkdir(parents=True, exist_ok=True)
    installed = shutil.copy(_RULES, _INSTALLED)
    run("udevadm", "control", "--reload")
    yield
    Path(installed).unlink()
    run("udevadm", "control", "--reload")


def test_hokuyo_on_usb_gets_the_name_scanner(acm: Cable) -> None:
    acm.unplug()
    acm.plug_in()

    for name in ("scanner", "scanner-H0000001"):
        assert Path("/dev/cairn", name).resolve() == acm.port
    assert (acm.port.group(), acm.port.stat().st_mode & 0o777) == ("dialout", 0o660)

    acm.unplug()
    assert not Path("/dev/cairn/scanner").is_symlink()


def test_rs_232_adapter_passes_bytes_on_without_delay(ftdi: Cable) -> None:
    ftdi.unplug()
    ftdi.plug_in()

    assert Path("/dev/cairn/rs232-RS232").resolve() == ftdi.port
    latency = Path("/sys/class/tty", ftdi.port.name, "device", "latency_timer")
    assert latency.read_text().strip() == "1"
