"""Cuts the bytes of a SCIP sensor into its replies: lines that end with an empty line."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.components.hokuyo.scip_text import checked

_END = b"\n\n"
_LONGEST = 65536  # bytes; no reply is longer: what is, is noise


@dataclass(frozen=True)
class Reply:
    """One reply as it came: the command's echo, the status, then what was asked for."""

    echo: bytes
    status: bytes
    """As it came: in SCIP 2 two characters and a check sum, in SCIP 1.1 one character."""
    body: bytes
    """All lines after the status, each but the last with its line feed."""

    @property
    def lines(self) -> list[bytes]:
        """The lines after the status, check sums included."""
        return self.body.split(b"\n") if self.body else []

    def code(self) -> str:
        """The status without its check sum; raises `ScipError` if that is wrong."""
        return checked(self.status).decode("ascii", "replace")


class ReplySplitter:
    """Collects bytes, gives replies. After noise it is in step again with the next empty line."""

    def __init__(self) -> None:
        self._held = b""
        self.noise = 0
        """How many bytes belonged to no reply so far."""

    def feed(self, data: bytes) -> list[Reply]:
        """The replies that these bytes complete."""
        self._held += data
        if _END not in data and _END not in self._held[-len(data) - 1 :]:
            if len(self._held) > _LONGEST:
                self.clear()
            return []
        *parts, self._held = self._held.split(_END)
        return [reply for part in parts if (reply := self._reply(part)) is not None]

    def clear(self) -> None:
        """Forget what has been begun."""
        self.noise += len(self._held)
        self._held = b""

    def _reply(self, part: bytes) -> Reply | None:
        # A reply without its end, or a line feed too many, leaves line feeds before the next one.
        part = part.lstrip(b"\n")
        echo, _, rest = part.partition(b"\n")
        status, _, body = rest.partition(b"\n")
        if not status:
            self.noise += len(part)
            return None
        return Reply(echo, status, body)
