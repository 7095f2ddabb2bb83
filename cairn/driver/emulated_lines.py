"""The device's end of a line in software: a pseudo-terminal, or a TCP port."""

from __future__ import annotations

import os
import socket
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from cairn.errors import CairnError


class LineEnd(Protocol):
    """Where an emulated device is plugged in. Methods raise `LinkLost` if a real line is gone."""

    def plug_in(self) -> None:
        """Be there for whoever opens the line; raises `CairnError` if that cannot be."""
        ...

    def unplug(self) -> None:
        """Be gone, for the one who has the line open as well; may be called again."""
        ...

    def readable(self) -> list[int]:
        """File descriptors that become readable when something happens."""
        ...

    def writable(self) -> int | None:
        """The file descriptor that becomes writable when more can be sent; None: nobody reads."""
        ...

    def take(self) -> bytes | None:
        """What has come, without waiting; None if whoever read has just hung up."""
        ...

    def give(self, data: bytes) -> int:
        """Send as much of it as goes without waiting: how many bytes."""
        ...

    def baud(self) -> int | None:
        """The speed at which the other end speaks [bit/s]; None if that is not known."""
        ...

    def set_baud(self, baud: int | None) -> None:
        """Speak at this speed [bit/s], where a line has speeds; None: it does not matter."""
        ...

    @property
    def where(self) -> str:
        """Where a driver finds it, in words."""
        ...


class PtyEnd:
    """A pseudo-terminal: a serial port that exists in software alone, under a name of one's choice.

    Speeds may be set and are not kept to; neither are data bits and parity.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._device: int | None = None
        self._line: int | None = None

    def plug_in(self) -> None:
        """Make it, and a symbolic link to it at the path."""
        if self._device is not None:
            return
        if self._path.is_symlink() and not self._path.exists():
            self._path.unlink()  # of one that was killed
        device, line = os.openpty()
        try:
            tty.setraw(line)
            os.set_blocking(device, False)
            os.symlink(os.ttyname(line), self._path)
        except OSError as error:
            os.close(device)
            os.close(line)
            raise CairnError(
                f"{self._path}: a link to a pseudo-terminal cannot be made here ({error.strerror});"
                " name a path that is free, in a folder that can be written to"
            ) from error
        # The line's own end stays open here: else reading would fail whenever nobody has it open.
        self._device, self._line = device, line

    def unplug(self) -> None:
        """Remove it: who has it open reads its end."""
        if self._device is None or self._line is None:
            return
        self._path.unlink(missing_ok=True)
        os.close(self._device)
        os.close(self._line)
        self._device = self._line = None

    def readable(self) -> list[int]:
        """The device's end."""
        return [] if self._device is None else [self._device]

    def writable(self) -> int | None:
        """The device's end: what is sent waits for whoever opens the line."""
        return self._device

    def take(self) -> bytes | None:
        """What has come."""
        if self._device is None:
            return b""
        with suppress(BlockingIOError):
            return os.read(self._device, 65536)
        return b""

    def give(self, data: bytes) -> int:
        """Send as much as goes."""
        if self._device is None:
            return 0
        with suppress(BlockingIOError):
            return os.write(self._device, data)
        return 0

    def baud(self) -> int | None:
        """The speed that whoever opened the line has set; None for one that POSIX has no name for.

        250000 and 750000 bit/s are such.
        """
        if self._line is None:
            return None
        speed = termios.tcgetattr(self._line)[5]
        return _SPEEDS.get(speed)

    def set_baud(self, baud: int | None) -> None:
        """Each end may claim any speed."""

    @property
    def where(self) -> str:
        """The path."""
        return f"{self._path} (a serial port in software)"


class TcpEnd:
    """A TCP port of this machine, which takes one client at a time."""

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        """Port 0 takes a free one; `port` tells which."""
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
        """Hang up, and listen no more."""
        for one in (self._client, self._listener):
            if one is not None:
                one.close()
        self._client = self._listener = None

    def readable(self) -> list[int]:
        """The port, for who comes; the client."""
        return [one.fileno() for one in (self._listener, self._client) if one is not None]

    def writable(self) -> int | None:
        """The client."""
        return None if self._client is None else self._client.fileno()

    def take(self) -> bytes | None:
        """What has come from the client; who comes as a second one is turned away."""
        if self._client is None:
            self._accept()
            return b""
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            self._accept()
            return b""
        except OSError:
            data = b""
        if data:
            return data
        self._client.close()  # before the next one, who may be waiting, is let in
        self._client = None
        return None

    def give(self, data: bytes) -> int:
        """Send as much as goes."""
        if self._client is None:
            return 0
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)  # it has hung up, which `take` tells

    def baud(self) -> int | None:
        """There is no speed."""
        return None

    def set_baud(self, baud: int | None) -> None:
        """There is no speed."""

    @property
    def where(self) -> str:
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


_SPEEDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdigit()
}
