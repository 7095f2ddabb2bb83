"""The device's end of a real serial line."""

from __future__ import annotations

import os
import termios

from cairn.driver.errors import LinkLost
from cairn.driver.link import SerialLink


class SerialEnd:
    """A real serial port of this machine: a device for another one, at the end of a cable."""

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
        """Close it."""
        if self._link is not None:
            self._link.close()
        self._link = None

    def readable(self) -> list[int]:
        """The port."""
        return [] if self._link is None else [self._link.fileno()]

    def writable(self) -> int | None:
        """The port."""
        return None if self._link is None else self._link.fileno()

    def take(self) -> bytes | None:
        """What has come."""
        return b"" if self._link is None else self._link.read(0.0)

    def give(self, data: bytes) -> int:
        """Send as much as goes."""
        if self._link is None:
            return 0
        try:
            return os.write(self._link.fileno(), data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise LinkLost(f"{self._port} is gone: {error.strerror}") from error

    def baud(self) -> int | None:
        """Nobody knows at which speed the other machine speaks."""
        return None

    def set_baud(self, baud: int | None) -> None:
        """Speak at this speed, once all is sent that was to be sent at the old one."""
        if self._link is None or baud is None or baud == self._baud:
            return
        termios.tcdrain(self._link.fileno())
        self._baud = baud
        self._link.set_baud(baud)

    @property
    def where(self) -> str:
        """The port."""
        return f"{self._port}, for whoever is at its other end"
