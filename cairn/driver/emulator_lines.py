"""The device's end of a line, for emulators: pseudo-terminal, TCP port, or real serial port."""

from __future__ import annotations

import os
import socket
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from cairn.driver.errors import LinkLost
from cairn.driver.serial_and_tcp import SerialLink
from cairn.errors import CairnError

_CHUNK_BYTES = 65536


class LineEnd(Protocol):
    """Where an emulated device is plugged in. Methods raise `LinkLost` if a real line is lost."""

    def plug_in(self) -> None:
        """Become present for hosts that open the line; raises `CairnError` if it cannot."""

    def unplug(self) -> None:
        """Vanish, also for a host that has the line open; may be called again."""

    def readable(self) -> list[int]:
        """Return file descriptors that become readable when something happens."""

    def writable(self) -> int | None:
        """Return the file descriptor that becomes writable when more can be sent.

        None if no host is connected.
        """

    def read(self) -> bytes | None:
        """Return what was received, without waiting; None if the host has just disconnected."""

    def write(self, data: bytes) -> int:
        """Send as much as possible without waiting; return how many bytes."""

    def baud(self) -> int | None:
        """Return the speed that the host uses [bit/s]; None if it is not known."""

    def set_baud(self, baud: int | None) -> None:
        """Use this speed [bit/s], where a line has speeds; None: it does not matter."""

    @property
    def address(self) -> str:
        """Where a driver finds the device, in words."""


class PtyEnd:
    """A pseudo-terminal: a virtual serial port, linked to by a path of one's choice.

    A host may set any speed, number of data bits and parity; the terminal applies none of them.
    The emulator compares the host's speed with that of the device: see `EmulatedDevice.baud`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._device: int | None = None
        self._line: int | None = None

    def plug_in(self) -> None:
        """Create it, and a symbolic link to it at the path."""
        if self._device is not None:
            return
        if self._path.is_symlink() and not self._path.exists():
            self._path.unlink()  # of an emulator that was killed
        device, line = os.openpty()
        try:
            tty.setraw(line)
            os.set_blocking(device, False)
            os.symlink(os.ttyname(line), self._path)
        except OSError as error:
            os.close(device)
            os.close(line)
            raise CairnError(
                f"{self._path}: a link to a pseudo-terminal cannot be created here "
                f"({error.strerror}); name a path that is free, in a folder that can be written to"
            ) from error
        # The host's end stays open here: otherwise reading fails whenever no host has it open.
        self._device, self._line = device, line

    def unplug(self) -> None:
        """Remove it: a host that has it open reads an end of file."""
        if self._device is None or self._line is None:
            return
        self._path.unlink(missing_ok=True)
        os.close(self._device)
        os.close(self._line)
        self._device = self._line = None

    def readable(self) -> list[int]:
        """Return the device's end."""
        return [] if self._device is None else [self._device]

    def writable(self) -> int | None:
        """Return the device's end: what is sent waits for a host to open the line."""
        return self._device

    def read(self) -> bytes | None:
        """Return what was received."""
        if self._device is None:
            return b""
        with suppress(BlockingIOError):
            return os.read(self._device, _CHUNK_BYTES)
        return b""

    def write(self, data: bytes) -> int:
        """Send as much as possible."""
        if self._device is None:
            return 0
        with suppress(BlockingIOError):
            return os.write(self._device, data)
        return 0

    def baud(self) -> int | None:
        """Return the speed that the host has set [bit/s].

        None for one that POSIX has no name for, such as 250000 and 750000 bit/s.
        """
        if self._line is None:
            return None
        speed = termios.tcgetattr(self._line)[5]
        return _SPEEDS.get(speed)

    def set_baud(self, baud: int | None) -> None:
        """Do nothing: a pseudo-terminal has no speed; see `baud` for that of the host."""

    @property
    def address(self) -> str:
        """The path."""
        return f"{self._path} (a pseudo-terminal)"


class TcpEnd:
    """A TCP port of this computer, which takes one client at a time."""

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        """Port 0 takes a free one when it is plugged in; `port` is its number then."""
        self.port = port
        self._host = host
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None

    def plug_in(self) -> None:
        """Listen."""
        if self._listener is not None:
            return
        try:
            self._listener = socket.create_server((self._host, self.port))
        except OSError as error:
            raise CairnError(
                f"{self._host}:{self.port} cannot be listened on ({error.strerror}); is another "
                "emulator running? Give another port, or 0 for a free one"
            ) from error
        self._listener.setblocking(False)
        self.port = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Close the connection and stop listening."""
        for one in (self._client, self._listener):
            if one is not None:
                one.close()
        self._client = self._listener = None

    def readable(self) -> list[int]:
        """Return the port, for new clients, and the client."""
        return [one.fileno() for one in (self._listener, self._client) if one is not None]

    def writable(self) -> int | None:
        """Return the client."""
        return None if self._client is None else self._client.fileno()

    def read(self) -> bytes | None:
        """Return what the client has sent; a second client is disconnected at once."""
        if self._client is None:
            self._accept()
            return b""
        try:
            data = self._client.recv(_CHUNK_BYTES)
        except BlockingIOError:
            self._accept()
            return b""
        except OSError:
            data = b""
        if data:
            return data
        self._client.close()  # before the next one, which may be waiting, is accepted
        self._client = None
        return None

    def write(self, data: bytes) -> int:
        """Send as much as possible."""
        if self._client is None:
            return 0
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)  # it has disconnected, which `read` reports

    def baud(self) -> int | None:
        """Return None: TCP has no speed."""
        return None

    def set_baud(self, baud: int | None) -> None:
        """Do nothing: TCP has no speed."""

    @property
    def address(self) -> str:
        """Address and port."""
        return f"{self._host}:{self.port} (TCP)"

    def _accept(self) -> None:
        if self._listener is None:
            return
        with suppress(BlockingIOError):
            client, _ = self._listener.accept()
            if self._client is not None:
                client.close()
                return
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client


class SerialEnd:
    """A real serial port of this computer, at the end of a cable to another one."""

    def __init__(self, port: str, baud: int, *, data_bits: int = 8) -> None:
        self._port = port
        self._baud = baud
        self._data_bits = data_bits
        self._link: SerialLink | None = None

    def plug_in(self) -> None:
        """Open the port."""
        if self._link is None:
            self._link = SerialLink(self._port, self._baud, data_bits=self._data_bits)

    def unplug(self) -> None:
        """Close the port."""
        if self._link is not None:
            self._link.close()
        self._link = None

    def readable(self) -> list[int]:
        """Return the port."""
        return [] if self._link is None else [self._link.fileno()]

    def writable(self) -> int | None:
        """Return the port."""
        return None if self._link is None else self._link.fileno()

    def read(self) -> bytes | None:
        """Return what was received."""
        return b"" if self._link is None else self._link.read(0.0)

    def write(self, data: bytes) -> int:
        """Send as much as possible."""
        if self._link is None:
            return 0
        try:
            return os.write(self._link.fileno(), data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise LinkLost(f"{self._port} is gone: {error.strerror}") from error

    def baud(self) -> int | None:
        """Return None: the speed of the other computer is not known."""
        return None

    def set_baud(self, baud: int | None) -> None:
        """Use this speed [bit/s], after everything queued for the old one is sent."""
        if self._link is None or baud is None or baud == self._baud:
            return
        termios.tcdrain(self._link.fileno())
        self._baud = baud
        self._link.set_baud(baud)

    @property
    def address(self) -> str:
        """The port."""
        return f"{self._port} (a serial port; the driver's computer is at the other end)"


_SPEEDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdigit()
}
