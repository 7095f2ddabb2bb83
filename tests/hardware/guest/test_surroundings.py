"""The devices that the guest's other tests use behave as these tests assume."""

import os
import select
import termios
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
import serial

from tests.hardware.guest.cables import Cable

_LIMIT_S = 20.0
_SCAN = bytes(range(256)) * 14


@pytest.fixture(params=["acm", "ftdi"])
def cable(request: pytest.FixtureRequest) -> Cable:
    """Each of the two kinds of serial devices."""
    found: Cable = request.getfixturevalue(request.param)
    return found


def test_bytes_are_transferred_in_both_directions(cable: Cable) -> None:
    with opened(cable.stable) as port, far_end(cable) as far:
        port.write(b"BM\n")
        assert received(far, 3) == b"BM\n"

        os.write(far, _SCAN)
        assert received(port.fileno(), len(_SCAN)) == _SCAN


def test_pulling_the_plug_raises_each_error_of_pyserial(cable: Cable) -> None:
    with opened(cable.port) as port:
        cable.unplug()

        with pytest.raises(serial.SerialException):
            port.read(1)
        with pytest.raises(serial.SerialException):
            port.write(b"QT\n")
        with pytest.raises(OSError, match="Input/output error"):
            _ = port.in_waiting
        with pytest.raises(termios.error):
            port.reset_input_buffer()
    assert not cable.stable.exists()


def test_replugged_device_works_again(cable: Cable) -> None:
    cable.unplug()
    cable.plug_in()

    with opened(cable.stable) as port, far_end(cable) as far:
        os.write(far, b"00P\n")
        assert received(port.fileno(), 4) == b"00P\n"


def opened(path: Path) -> serial.Serial:
    """A port as drivers open it."""
    return serial.Serial(str(path), 115200, timeout=_LIMIT_S, write_timeout=_LIMIT_S)


@contextmanager
def far_end(cable: Cable) -> Iterator[int]:
    """The line's far end, raw."""
    with closing(opened(cable.far_end)) as far:
        yield far.fileno()


def received(descriptor: int, count: int) -> bytes:
    """The next bytes of a line."""
    got = b""
    deadline = time.monotonic() + _LIMIT_S
    while len(got) < count:
        left_s = max(0.0, deadline - time.monotonic())
        readable, _, _ = select.select([descriptor], [], [], left_s)
        assert readable, f"{len(got)} of {count} bytes within {_LIMIT_S:g} s: {got[:80]!r}"
        got += os.read(descriptor, count - len(got))
    return got
