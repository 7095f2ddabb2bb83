"""Lines to devices carry bytes both ways; errors have the name and the cause."""

from __future__ import annotations

import select
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from serial.tools import list_ports

from cairn.driver.emulator_lines import PtyEnd
from cairn.driver.errors import LinkLost
from cairn.driver.serial_and_tcp import SerialLink, TcpLink
from cairn.driver.usb_ports import find_port
from cairn.testing.launching import free_port
from tests.patience import LIMIT_S
from tests.wording import words_in_order


@pytest.fixture
def end(tmp_path: Path) -> Any:
    end = PtyEnd(tmp_path / "device")
    end.plug_in()
    yield end
    end.unplug()


def test_bytes_are_transferred_in_both_directions_over_a_serial_line(
    end: PtyEnd, tmp_path: Path
) -> None:
    link = SerialLink(str(tmp_path / "device"), 115200)
    link.write(b"QT\n")
    end.write(b"00P\n\n")

    assert link.read(LIMIT_S) == b"00P\n\n"
    select.select(end.readable(), [], [], LIMIT_S)  # the system passes bytes on when it has time
    assert end.read() == b"QT\n"
    assert link.read(0.0) == b""
    end.write(b"old")
    assert link.read(LIMIT_S)
    link.discard()
    link.close()
    link.close()


def test_port_is_opened_exclusively(end: PtyEnd, tmp_path: Path) -> None:
    link = SerialLink(str(tmp_path / "device"), 115200)
    with pytest.raises(LinkLost, match=words_in_order("device", "another program")):
        SerialLink(str(tmp_path / "device"), 115200)
    link.close()


def test_missing_port_raises_link_lost(tmp_path: Path) -> None:
    with pytest.raises(LinkLost, match=words_in_order("nothing", "No such file")):
        SerialLink(str(tmp_path / "nothing"), 115200)


def test_file_is_rejected_as_a_port(tmp_path: Path) -> None:
    (tmp_path / "notes").touch()

    with pytest.raises(LinkLost, match=r"notes cannot be opened: .*serial port"):
        SerialLink(str(tmp_path / "notes"), 115200)


def test_every_operation_on_an_unplugged_port_raises_link_lost(end: PtyEnd, tmp_path: Path) -> None:
    link = SerialLink(str(tmp_path / "device"), 115200)
    end.unplug()

    for do in (lambda: link.read(LIMIT_S), lambda: link.write(b"x"), link.discard):
        with pytest.raises(LinkLost, match="device is gone"):
            do()
    with pytest.raises(LinkLost):
        link.set_baud(19200)
    link.close()


@pytest.fixture
def server() -> Any:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def test_bytes_are_transferred_in_both_directions_over_tcp(server: socket.socket) -> None:
    link = TcpLink("127.0.0.1", server.getsockname()[1])
    peer, _ = server.accept()
    link.write(b"QT\n")
    assert peer.recv(10) == b"QT\n"
    peer.sendall(b"00P")
    assert link.read(LIMIT_S) == b"00P"
    assert link.read(0.0) == b""
    link.set_baud(19200)
    peer.sendall(b"old")
    assert link.read(LIMIT_S)
    link.discard()
    peer.close()

    with pytest.raises(LinkLost, match=r"127.0.0.1:\d+ has closed the connection"):
        link.read(LIMIT_S)
    link.close()


def test_refused_connection_raises_link_lost() -> None:
    port = free_port()

    with pytest.raises(LinkLost, match=rf"127.0.0.1:{port} cannot be connected: Connection refu"):
        TcpLink("127.0.0.1", port)


def _port(device: str, vid: int | None, pid: int | None, number: str | None) -> Any:
    return SimpleNamespace(device=device, vid=vid, pid=pid, serial_number=number)


def test_ports_are_found_by_usb_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    there = [
        _port("/dev/ttyS0", None, None, None),
        _port("/dev/ttyACM0", 0x15D1, 0, "H1"),
        _port("/dev/ttyACM1", 0x15D1, 0, "H2"),
        _port("/dev/ttyUSB0", 0x0403, 0x6001, "A1:B2"),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: there)

    assert find_port("/dev/serial/by-id/anything") == "/dev/serial/by-id/anything"
    assert find_port("usb:15d1:0000:H2") == "/dev/ttyACM1"
    assert find_port("usb:0403:6001") == "/dev/ttyUSB0"
    assert find_port("usb:0403:6001:A1:B2") == "/dev/ttyUSB0"
    with pytest.raises(
        LinkLost,
        match=r"several .*: /dev/ttyACM0 \(H1\), /dev/ttyACM1 \(H2\)",
    ):
        find_port("usb:15D1:0000")
    with pytest.raises(LinkLost, match=words_in_order("usb:15d1:0000:H3", "plugged in")):
        find_port("usb:15d1:0000:H3")
