"""The records of an MCAP file: how their fields are read and written. Format: mcap.dev/spec."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

MAGIC: Final = b"\x89MCAP0\r\n"
"""The first and the last bytes of a file."""

RECORD: Final = struct.Struct("<BQ")
"""Before each record: its kind and the length of its content."""

MESSAGE_OPCODE: Final = 5
"""Messages have no class here: there are millions of them."""

MESSAGE: Final = struct.Struct("<HIQQ")
"""Before the data of a message: channel, sequence, log time and publish time."""

_PAIRS: Final = {"m": "ss", "c": "HQ", "l": "QQ"}
_NUMBERS: Final = {letter: struct.Struct("<" + letter) for letter in "BHIQ"}


class Fields:
    """Reads the fields of a record one after the other; `ValueError` if it is too short."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def take(self, layout: str) -> list[Any]:
        """Return the next fields; `McapRecord` explains the layout."""
        return [self._field(kind) for kind in layout]

    def data(self, size: int) -> bytes:
        """Return the next bytes."""
        end = self._at + size
        if end > len(self._content):
            raise ValueError(f"it has {len(self._content):,} bytes, a field ends at {end:,}")
        data = self._content[self._at : end]
        self._at = end
        return data

    def rest(self) -> bytes:
        """Return all bytes that are left."""
        return self._content[self._at :]

    def _field(self, kind: str) -> Any:
        match kind:
            case "s":
                return self._field("d").decode()
            case "d":
                return self.data(self._field("I"))
            case "D":
                return self.data(self._field("Q"))
            case "m" | "c":
                return dict(self._pairs(kind))
            case "l":
                return list(self._pairs(kind))
        number = _NUMBERS[kind]
        return number.unpack(self.data(number.size))[0]

    def _pairs(self, kind: str) -> Iterator[list[Any]]:
        size = self._field("I")
        end = self._at + size
        while self._at < end:
            yield self.take(_PAIRS[kind])


def packed_fields(layout: str, *values: Any) -> bytes:
    """Return fields as bytes; `McapRecord` explains the layout."""
    return b"".join(map(_packed, layout, values))


def _packed(kind: str, value: Any) -> bytes:
    if kind in _PAIRS:
        pairs = value.items() if isinstance(value, Mapping) else value
        return _packed("d", b"".join(packed_fields(_PAIRS[kind], *pair) for pair in pairs))
    match kind:
        case "s":
            return _packed("d", value.encode())
        case "d":
            return _packed("I", len(value)) + bytes(value)
        case "D":
            return _packed("Q", len(value)) + bytes(value)
    return _NUMBERS[kind].pack(value)


@dataclass(frozen=True)
class McapRecord:
    """A record of one kind; `LAYOUT` has a letter for each field in the order of the file.

    B, H, I, Q: a number of 1, 2, 4, 8 bytes; s: text; d, D: bytes with a length of 4, 8 bytes;
    m: a map of texts; c: a number for each channel; l: a list of pairs of numbers.
    """

    OPCODE: ClassVar[int]
    LAYOUT: ClassVar[str]

    def __init_subclass__(cls, *, opcode: int, layout: str) -> None:
        """Set the number of the kind, and the layout."""
        cls.OPCODE, cls.LAYOUT = opcode, layout

    @classmethod
    def read(cls, content: bytes) -> Self:
        """Return the record with this content; raise `ValueError` if it is too short."""
        return cls(*Fields(content).take(cls.LAYOUT))

    def packed(self) -> bytes:
        """Return the record with its kind and length."""
        content = packed_fields(self.LAYOUT, *vars(self).values())
        return RECORD.pack(self.OPCODE, len(content)) + content


@dataclass(frozen=True)
class HeaderRecord(McapRecord, opcode=1, layout="ss"):
    """The first record: which profile the file follows, and what wrote it."""

    profile: str
    library: str


@dataclass(frozen=True)
class Schema(McapRecord, opcode=3, layout="Hssd"):
    """The definition of a message type."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class ChannelRecord(McapRecord, opcode=4, layout="HHssm"):
    """A topic and the schema of its messages; schema 0: none."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class Chunk(McapRecord, opcode=6, layout="QQQIsD"):
    """Compressed records."""

    HEAD: ClassVar = "QQQIsQ"
    """The layout of all before the data, the last number being their size."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    data: bytes

    @classmethod
    def read_cut_off(cls, content: bytes) -> Self:
        """Return the chunk that begins with this content, with the data that are there."""
        fields = Fields(content)
        start_ns, end_ns, size, crc, compression, _ = fields.take(cls.HEAD)
        return cls(start_ns, end_ns, size, crc, compression, fields.rest())


@dataclass(frozen=True)
class MessageIndex(McapRecord, opcode=7, layout="Hl"):
    """Log time and position of each message of a channel in a chunk."""

    channel: int
    entries: list[tuple[int, int]]


@dataclass(frozen=True)
class ChunkIndex(McapRecord, opcode=8, layout="QQQQcQsQQ"):
    """Where a chunk is, and for each channel where its index of messages is."""

    start_ns: int
    end_ns: int
    chunk_at: int
    chunk_length: int
    message_indexes: Mapping[int, int]
    message_indexes_length: int
    compression: str
    compressed_size: int
    uncompressed_size: int


@dataclass(frozen=True)
class AttachmentRecord(McapRecord, opcode=9, layout="QQssDI"):
    """An attached file; `crc` is that of all other fields, 0 if there is none."""

    HEAD: ClassVar = "QQssQ"
    """The layout of all before the data, the last number being their size."""

    log_ns: int
    created_ns: int
    name: str
    media_type: str
    data: bytes
    crc: int = 0


@dataclass(frozen=True)
class AttachmentIndex(McapRecord, opcode=10, layout="QQQQQss"):
    """Where an attachment is."""

    at: int
    length: int
    log_ns: int
    created_ns: int
    size: int
    name: str
    media_type: str


@dataclass(frozen=True)
class Metadata(McapRecord, opcode=12, layout="sm"):
    """Named texts."""

    name: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class MetadataIndex(McapRecord, opcode=13, layout="QQs"):
    """Where metadata are."""

    at: int
    length: int
    name: str


@dataclass(frozen=True)
class Statistics(McapRecord, opcode=11, layout="QHIIIIQQc"):
    """How much a file holds, and how many messages of each channel."""

    messages: int
    schemas: int
    channels: int
    attachments: int
    metadata: int
    chunks: int
    start_ns: int
    end_ns: int
    of_channels: Mapping[int, int]


@dataclass(frozen=True)
class SummaryOffset(McapRecord, opcode=14, layout="BQQ"):
    """Where the records of a kind are in the summary."""

    opcode: int
    at: int
    length: int


@dataclass(frozen=True)
class DataEnd(McapRecord, opcode=15, layout="I"):
    """After the last record of data; checksum 0: none."""

    crc: int = 0


@dataclass(frozen=True)
class Footer(McapRecord, opcode=2, layout="QQI"):
    """Where the summary begins; 0: there is none."""

    summary_at: int
    offsets_at: int
    summary_crc: int
