"""Recovery of ROS 1 bags: reads a bag from start to end without its index, past damaged parts.

Format: wiki.ros.org/Bags/Format/2.0, and 1.2 of the year 2009. A record is a header (length, then
fields `name=value`, each with its length) and data (length, then bytes); in format 2.0 messages
are in chunks of records. rosbags needs the index and rejects bags that were not closed.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rosbags.rosbag1.reader import decompressors

from cairn.components.replay.recording import RecordingError

_DEFINITION_1_2, _MESSAGE, _HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(1, 8)
_LONGEST_HEADER = 1 << 16
_UINT32 = struct.Struct("<I")
_TIME = struct.Struct("<II")


@dataclass(frozen=True)
class BagConnection:
    """A topic of a bag with its message type, `package/Name`, and that type's definition."""

    topic: str
    type: str
    definition: str


@dataclass
class SequentialBagReader:
    """Reads a bag in sequence; `lost` is complete when the iteration has ended."""

    path: Path
    lost: list[str] = field(default_factory=list)
    _connections: dict[bytes, BagConnection] = field(default_factory=dict)

    def messages(self) -> Iterator[tuple[BagConnection, int, bytes]]:
        """Yield connection, time of receipt [ns] and serialized bytes of each message."""
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be read: {error.strerror}.") from error
        at = data.find(b"\n") + 1
        yield from self._records(data, at, "")

    def _records(
        self, data: bytes, at: int, location: str
    ) -> Iterator[tuple[BagConnection, int, bytes]]:
        while at < len(data):
            record = _record(data, at)
            if record is None:
                resumed = _next_chunk(data, at + 1) if not location else None
                end = len(data) if resumed is None else resumed
                self.lost.append(f"{end - at} bytes from byte {at}{location} on are damaged")
                if resumed is None:
                    return
                at = resumed
                continue
            header, body, after = record
            kind = header["op"][0]
            if kind == _CHUNK:
                inner = f" of the chunk at byte {at}"
                unpacked = self._unpack(header.get("compression", b""), body, at)
                yield from self._records(unpacked, 0, inner)
            elif kind in (_CONNECTION, _DEFINITION_1_2):
                self._connect(header, body)
            elif kind == _MESSAGE:
                message = self._message(header, body)
                if message is None:
                    self.lost.append(f"the message at byte {at}{location} belongs to no topic")
                else:
                    yield message
            at = after

    def _unpack(self, compression: bytes, body: bytes, at: int) -> bytes:
        try:
            return decompressors[_text(compression)](body)
        except KeyError:
            self.lost.append(f"the chunk at byte {at} is compressed by {_text(compression)!r}")
        except (OSError, ValueError, RuntimeError, EOFError) as error:
            self.lost.append(f"the chunk at byte {at} cannot be decompressed ({error})")
        return b""

    def _connect(self, header: dict[str, bytes], body: bytes) -> None:
        described = header if "def" in header else (_fields(body) or {})
        definition = described.get("message_definition", described.get("def", b""))
        topic = header.get("topic", b"")
        if described.get("type"):
            known = BagConnection(_text(topic), _text(described["type"]), _text(definition))
            self._connections[header.get("conn", topic)] = known

    def _message(
        self, header: dict[str, bytes], body: bytes
    ) -> tuple[BagConnection, int, bytes] | None:
        connection = self._connections.get(header.get("conn", header.get("topic", b"")))
        if "time" in header and len(header["time"]) == _TIME.size:
            seconds, nanoseconds = _TIME.unpack(header["time"])
        elif len(header.get("sec", b"")) == len(header.get("nsec", b"")) == _UINT32.size:
            seconds, nanoseconds = _TIME.unpack(header["sec"] + header["nsec"])
        else:
            return None
        if connection is None:
            return None
        return connection, seconds * 1_000_000_000 + nanoseconds, body


def _record(data: bytes, at: int) -> tuple[dict[str, bytes], bytes, int] | None:
    """Return header, data and end of the record at byte `at`, None if there is none."""
    head = _sized(data, at)
    if head is None or head[1] - at > _LONGEST_HEADER:
        return None
    header = _fields(head[0])
    if not header or len(header.get("op", b"")) != 1:
        return None
    if header["op"][0] not in range(_DEFINITION_1_2, _CONNECTION + 1):
        return None
    body = _sized(data, head[1])
    if body is None or not _whole_index(header, body[0]):
        return None
    return header, *body


def _whole_index(header: dict[str, bytes], body: bytes) -> bool:
    """Return whether an index is as long as its entries; else what follows would be skipped."""
    if header["op"][0] != _INDEX or header.get("ver") != _UINT32.pack(1):
        return True
    return header.get("count") == _UINT32.pack(len(body) // 12) and len(body) % 12 == 0


def _sized(data: bytes, at: int) -> tuple[bytes, int] | None:
    """Return the bytes that follow their length at byte `at`, and their end."""
    if at + 4 > len(data):
        return None
    end = at + 4 + int(_UINT32.unpack_from(data, at)[0])
    return None if end > len(data) else (data[at + 4 : end], end)


def _fields(head: bytes) -> dict[str, bytes] | None:
    fields: dict[str, bytes] = {}
    at = 0
    while at < len(head):
        entry = _sized(head, at)
        if entry is None or b"=" not in entry[0]:
            return None
        name, _, value = entry[0].partition(b"=")
        fields[_text(name)] = value
        at = entry[1]
    return fields


def _next_chunk(data: bytes, at: int) -> int | None:
    """Return where the next whole chunk starts."""
    found = data.find(b"op=\x05", at)
    while found >= 0:
        # Its fields `compression` and `size` are before or after `op`, in any order.
        for start in range(found - 8, max(at, found - 64) - 1, -1):
            record = _record(data, start)
            if record is not None and "compression" in record[0]:
                return start
        found = data.find(b"op=\x05", found + 1)
    return None


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", errors="replace")
