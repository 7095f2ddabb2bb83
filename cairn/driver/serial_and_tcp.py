"""Lines to devices: serial ports and TCP connections, as byte streams with time limits."""

from __future__ import annotations

import errno
import os
import select
import socket
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Protocol

import serial

from cairn.driver.errors import DeviceError, LinkLost
from cairn.driver.usb_ports import find_port

_CHUNK_BYTES = 65536
_WRITE_TIMEOUT_S = 1.0
_CAUSES = {
    errno.EAGAIN: "another program has it open; `cairn doctor` shows which",
    errno.EACCES: "permission denied; the user is not in the device's group; `cairn doctor` shows "
    "the remedy",
    errno.ENOENT: "No such file or directory; plug the device in, or correct the name; `cairn "
    "doctor` lists what is connected",
    errno.ENOTTY: "it is not a serial port",
    errno.ECONNRESET: "it has closed the connection; perhaps another program is connected to it",
}

# RS-232 of all kinds; USB devices of class CDC (ttyACM) and pseudo-terminals have no speed.
_PACED = ("ttyUSB", "ttyS", "ttyAMA", "ttyO", "ttyTHS", "ttymxc")


class Link(Protocol):
    """A line to a device. One thread uses it at a time."""

    name: str
    """Its name in errors: `/dev/ttyACM0`, `192.168.0.10:10940`."""
    paced: bool
    """Whether bytes take the time that the line's speed gives them, as on RS-232."""

    def read(self, timeout_s: float) -> bytes:
        """Return what has been received, waiting up to `timeout_s` [s] for the first byte.

        Empty if nothing was received. Raises `LinkLost` if the line is lost.
        """

    def write(self, data: bytes) -> None:
        """Send all bytes within a second; raises `LinkLost` if that is not possible."""

    def set_baud(self, baud: int) -> None:
        """Change the speed [bit/s]; does nothing where a line has no speed.

        Raises `LinkLost` if the line is lost, `DeviceError` if the port lacks that speed.
        """

    def discard(self) -> None:
        """Discard what was received and not read; raises `LinkLost` if the line is lost."""

    def close(self) -> None:
        """Close the line; may be called again."""


class SerialLink:
    """A serial port (RS-232, USB-CDC, PTY), opened for this process alone by pyserial.

    Bytes are read by system calls as they arrive: pyserial's own `read_until` makes a call for each
    byte, which takes half a core for a fast scanner.
    """

    def __init__(self, port: str, baud: int, *, data_bits: int = 8) -> None:
        """Open a port, named as `find_port` takes it.

        Raises `LinkLost`, with the cause, if there is none, or it cannot be opened.
        """
        device = find_port(port)
        self.name = port if device == port else f"{port} ({device})"
        self.paced = os.path.basename(os.path.realpath(device)).startswith(_PACED)
        if os.path.realpath(device).startswith("/dev/pts/"):
            data_bits = 8  # a pseudo-terminal refuses fewer
        try:
            self._serial = serial.Serial(
                device, baud, bytesize=data_bits, timeout=0, write_timeout=_WRITE_TIMEOUT_S,
                exclusive=True,
            )  # fmt: skip
        except (serial.SerialException, OSError, termios.error, ValueError) as error:
            raise LinkLost(f"{self.name} cannot be opened: {_cause(error)}") from error

    def fileno(self) -> int:
        """Return the file descriptor, for waiting."""
        return self._serial.fileno()

    def read(self, timeout_s: float) -> bytes:
        """Return what has been received, waiting up to `timeout_s` [s] for the first byte."""
        with _lost_on_failure(self.name):
            descriptor = self._serial.fileno()
            ready, _, _ = select.select([descriptor], [], [], timeout_s)
            if not ready:
                return b""
            data = os.read(descriptor, _CHUNK_BYTES)
        if not data:
            raise LinkLost(f"{self.name} is gone: it was unplugged, or hung up")
        return data

    def write(self, data: bytes) -> None:
        """Send all bytes."""
        with _lost_on_failure(self.name):
            self._serial.write(data)

    def set_baud(self, baud: int) -> None:
        """Change the speed [bit/s]."""
        with _lost_on_failure(self.name):
            try:
                self._serial.baudrate = baud
            except ValueError as error:
                raise DeviceError(f"{self.name}: the port has no speed of {baud} bit/s") from error

    def discard(self) -> None:
        """Discard what was received and not read."""
        with _lost_on_failure(self.name):
            self._serial.reset_input_buffer()

    def close(self) -> None:
        """Close the port."""
        # A port that was unplugged cannot be closed in good order; it is gone all the same.
        with suppress(serial.SerialException, OSError, termios.error):
            self._serial.close()


class TcpLink:
    """A device behind a TCP port: a scanner on Ethernet, or a serial device server."""

    def __init__(self, host: str, port: int, timeout_s: float = 2.0) -> None:
        """Connect within `timeout_s` [s]; raises `LinkLost`, with the cause, if that fails."""
        self.name = f"{host}:{port}"
        self.paced = False
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
        except (OSError, UnicodeError) as error:
            raise LinkLost(f"{self.name} cannot be connected: {_cause(error)}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(_WRITE_TIMEOUT_S)

    def read(self, timeout_s: float) -> bytes:
        """Return what has been received, waiting up to `timeout_s` [s] for the first byte."""
        with _lost_on_failure(self.name):
            ready, _, _ = select.select([self._socket], [], [], timeout_s)
            if not ready:
                return b""
            data = self._socket.recv(_CHUNK_BYTES)
        if not data:
            raise LinkLost(
                f"{self.name} has closed the connection: the device was switched off, or another "
                "program uses it"
            )
        return data

    def write(self, data: bytes) -> None:
        """Send all bytes."""
        with _lost_on_failure(self.name):
            self._socket.sendall(data)

    def set_baud(self, baud: int) -> None:
        """Do nothing: TCP has no speed."""

    def discard(self) -> None:
        """Discard what was received and not read."""
        while self.read(0.0):
            pass

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


@contextmanager
def _lost_on_failure(name: str) -> Iterator[None]:
    """Turn what a line raises when it fails into `LinkLost`, with the cause."""
    try:
        yield
    except (serial.SerialException, OSError, termios.error, ValueError) as error:
        raise LinkLost(f"{name} is gone: {_cause(error)}") from error


def _cause(error: BaseException) -> str:
    if isinstance(error, socket.gaierror):
        return f"{error.strerror}; check the address"
    number = getattr(error, "errno", None)
    if isinstance(error, termios.error):
        number = error.args[0] if error.args else None
    elif isinstance(error.__context__, termios.error):
        return _cause(error.__context__)  # pyserial says only that it failed
    if isinstance(number, int):
        return _CAUSES.get(number, os.strerror(number))
    return str(error)
