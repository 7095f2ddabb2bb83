"""Lines to devices: serial ports and TCP connections, as streams of bytes with time limits."""

from __future__ import annotations

import errno
import os
import select
import socket
import termios
from contextlib import suppress
from typing import Protocol

import serial

from cairn.driver.errors import DeviceError, LinkLost
from cairn.driver.ports import find_port, is_paced

_CHUNK = 65536
_KNOWN = {
    errno.EAGAIN: "another program has it open, as `cairn doctor` tells",
    errno.EACCES: "permission denied; the user lacks the group of the device, as `cairn doctor` "
    "tells",
    errno.ENOTTY: "it is no serial port",
    errno.ECONNRESET: "it has closed the connection; perhaps another program is connected to it",
}
_WRITE_LIMIT_S = 1.0


class Link(Protocol):
    """A line to a device. One thread uses it at a time."""

    name: str
    """What errors call it: `/dev/ttyACM0`, `192.168.0.10:10940`."""
    paced: bool
    """Whether bytes take the time that the line's speed gives them, as on RS-232."""

    def read(self, limit_s: float) -> bytes:
        """What has come, waiting for the first byte up to `limit_s` [s]; empty if none came.

        Raises `LinkLost` if the line is gone.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all of it, within a second; raises `LinkLost` if that cannot be done."""
        ...

    def set_baud(self, baud: int) -> None:
        """Speak at this speed from now on [bit/s]; does nothing where a line has no speed.

        Raises `LinkLost` if the line is gone, `DeviceError` if it knows no such speed.
        """
        ...

    def discard(self) -> None:
        """Throw away what has come and was not read; raises `LinkLost` if the line is gone."""
        ...

    def close(self) -> None:
        """Let go of it; may be called again."""
        ...


class SerialLink:
    """A serial port (RS-232, USB-CDC, PTY), for this process alone, by pyserial.

    Bytes are read by the system's calls as they come: pyserial's own `read_until` makes a call for
    each byte, which takes half a core for a fast scanner.
    """

    def __init__(self, port: str, baud: int, *, data_bits: int = 8) -> None:
        """Open a port named as `cairn.driver.ports.find_port` takes it.

        Raises `LinkLost` if there is none, or it cannot be opened: with the cause.
        """
        device = find_port(port)
        self.name = port if device == port else f"{port} ({device})"
        self.paced = is_paced(device)
        if os.path.realpath(device).startswith("/dev/pts/"):
            data_bits = 8  # no line has fewer in software: it would be refused
        try:
            self._serial = serial.Serial(
                device, baud, bytesize=data_bits, timeout=0, write_timeout=_WRITE_LIMIT_S,
                exclusive=True,
            )  # fmt: skip
        except (serial.SerialException, OSError, termios.error, ValueError) as error:
            raise LinkLost(f"{self.name} cannot be opened: {_cause(error)}") from error

    def fileno(self) -> int:
        """The file descriptor, for waiting."""
        return self._serial.fileno()

    def read(self, limit_s: float) -> bytes:
        """What has come, waiting up to `limit_s` [s] for the first byte."""
        try:
            descriptor = self._serial.fileno()
            ready, _, _ = select.select([descriptor], [], [], limit_s)
            if not ready:
                return b""
            data = os.read(descriptor, _CHUNK)
        except (serial.SerialException, OSError, termios.error) as error:
            raise self._lost(error) from error
        if not data:
            raise LinkLost(f"{self.name} is gone: it was unplugged, or hung up")
        return data

    def write(self, data: bytes) -> None:
        """Send all of it."""
        try:
            self._serial.write(data)
        except (serial.SerialException, OSError, termios.error) as error:
            raise self._lost(error) from error

    def set_baud(self, baud: int) -> None:
        """Speak at this speed from now on [bit/s]."""
        try:
            self._serial.baudrate = baud
        except ValueError as error:
            raise DeviceError(f"{self.name} knows no speed of {baud} bit/s") from error
        except (serial.SerialException, OSError, termios.error) as error:
            raise self._lost(error) from error

    def discard(self) -> None:
        """Throw away what has come and was not read."""
        try:
            self._serial.reset_input_buffer()
        except (serial.SerialException, OSError, termios.error) as error:
            raise self._lost(error) from error

    def close(self) -> None:
        """Let go of the port."""
        # A port that was unplugged cannot be closed in good order; it is gone all the same.
        with suppress(serial.SerialException, OSError, termios.error):
            self._serial.close()

    def _lost(self, error: Exception) -> LinkLost:
        return LinkLost(f"{self.name} is gone: {_cause(error)}")


class TcpLink:
    """A device behind a TCP port: a scanner on Ethernet, or a serial device server."""

    def __init__(self, host: str, port: int, limit_s: float = 2.0) -> None:
        """Connect within `limit_s` [s]; raises `LinkLost` if that fails, with the cause."""
        self.name = f"{host}:{port}"
        self.paced = False
        try:
            self._socket = socket.create_connection((host, port), limit_s)
        except (OSError, UnicodeError) as error:
            raise LinkLost(f"{self.name} cannot be connected: {_cause(error)}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(_WRITE_LIMIT_S)

    def read(self, limit_s: float) -> bytes:
        """What has come, waiting up to `limit_s` [s] for the first byte."""
        try:
            ready, _, _ = select.select([self._socket], [], [], limit_s)
            if not ready:
                return b""
            data = self._socket.recv(_CHUNK)
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        if not data:
            raise LinkLost(
                f"{self.name} has closed the connection: switched off, or another program uses it"
            )
        return data

    def write(self, data: bytes) -> None:
        """Send all of it."""
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise self._lost(error) from error

    def set_baud(self, baud: int) -> None:
        """There is no speed to set."""

    def discard(self) -> None:
        """Throw away what has come and was not read."""
        while self.read(0.0):
            pass

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def _lost(self, error: Exception) -> LinkLost:
        return LinkLost(f"{self.name} is gone: {_cause(error)}")


def _cause(error: BaseException) -> str:
    if isinstance(error, socket.gaierror):
        return f"{error.strerror}; is the address right?"
    number = getattr(error, "errno", None)
    if isinstance(error, termios.error):
        number = error.args[0] if error.args else None
    elif isinstance(error.__context__, termios.error):
        return _cause(error.__context__)  # pyserial says only that it failed
    if isinstance(number, int):
        return _KNOWN.get(number, os.strerror(number))
    return str(error)
