"""The records of an MCAP file: how their fields are read and written. Format: mcap.dev/spec."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from enum import IntEnum
from typing import Final, NamedTuple
from zlib import crc32

MAGIC: Final = b"\x89MCAP0\r\n"
"""The first and the last bytes of a file."""

RECORD: Final = struct.Struct("<BQ")
"""Before each record: its kind and the length of its content."""

MESSAGE: Final = struct.Struct("<HIQQ")
"""Before the data of a message: channel, sequence, log time and publish time."""

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_COUNT = struct.Struct("<HQ")  # of a channel: a number of messages, or a position


class Opcode(IntEnum):
    """The kinds of records."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


class Fields:
    """Reads the fields of a record one after the other; `ValueError` if it is too short."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def data(self, size: int) -> bytes:
        """Return the next bytes."""
        end = self._at + size
        if end > len(self._content):
            raise ValueError(f"it has {len(self._content):,} bytes, a field ends at {end:,}")
        data = self._content[self._at : end]
        self._at = end
        return data

    def number(self, layout: struct.Struct = _U64) -> int:
        """Return the next number."""
        return int(layout.unpack(self.data(layout.size))[0])

    def numbers(self, layout: struct.Struct) -> tuple[int, ...]:
        """Return the next numbers."""
        return layout.unpack(self.data(layout.size))

    def text(self) -> str:
        """Return the next text."""
        return self.data(self.number(_U32)).decode()

    def texts(self) -> dict[str, str]:
        """Return the next map of texts."""
        found: dict[str, str] = {}
        for _ in self._until_end_of_list():
            key = self.text()
            found[key] = self.text()
        return found

    def counts(self) -> dict[int, int]:
        """Return the next map of a number for each channel."""
        return dict(self.numbers(_COUNT) for _ in self._until_end_of_list())  # type: ignore[misc]

    def _until_end_of_list(self) -> Iterator[None]:
        size = self.number(_U32)
        end = self._at + size
        while self._at < end:
            yield


class Schema(NamedTuple):
    """The definition of a message type."""

    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def read(cls, content: bytes) -> Schema:
        """Return the schema of a record's content."""
        fields = Fields(content)
        number, name, encoding = fields.number(_U16), fields.text(), fields.text()
        return cls(number, name, encoding, fields.data(fields.number(_U32)))

    def packed(self) -> bytes:
        """Return the record."""
        parts = (_U16.pack(self.id), text(self.name), text(self.encoding), _sized(self.data))
        return record(Opcode.SCHEMA, *parts)


class Channel(NamedTuple):
    """A topic and the schema of its messages; schema 0: none."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]

    @classmethod
    def read(cls, content: bytes) -> Channel:
        """Return the channel of a record's content."""
        fields = Fields(content)
        number, schema = fields.number(_U16), fields.number(_U16)
        return cls(number, schema, fields.text(), fields.text(), fields.texts())

    def packed(self) -> bytes:
        """Return the record."""
        ids = _U16.pack(self.id) + _U16.pack(self.schema_id)
        names = text(self.topic) + text(self.message_encoding)
        return record(Opcode.CHANNEL, ids, names, texts(self.metadata))


class Chunk(NamedTuple):
    """Compressed records."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    data: bytes

    @classmethod
    def read(cls, content: bytes) -> Chunk:
        """Return the chunk of a record's content."""
        fields = Fields(content)
        start_ns, end_ns, size, crc = fields.numbers(_CHUNK)
        return cls(start_ns, end_ns, size, crc, fields.text(), fields.data(fields.number()))

    def packed(self) -> bytes:
        """Return the record."""
        numbers = _CHUNK.pack(*self[:4])
        length = _U64.pack(len(self.data))
        return record(Opcode.CHUNK, numbers, text(self.compression), length, self.data)


_CHUNK = struct.Struct("<QQQI")


class ChunkIndex(NamedTuple):
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

    @classmethod
    def read(cls, content: bytes) -> ChunkIndex:
        """Return the index of a record's content."""
        fields = Fields(content)
        start_ns, end_ns, at, length = fields.numbers(_FOUR)
        offsets, size, compression = fields.counts(), fields.number(), fields.text()
        numbers = fields.number(), fields.number()
        return cls(start_ns, end_ns, at, length, offsets, size, compression, *numbers)

    def packed(self) -> bytes:
        """Return the record."""
        numbers, offsets = _FOUR.pack(*self[:4]), counts(self.message_indexes)
        size, compression = _U64.pack(self.message_indexes_length), text(self.compression)
        return record(Opcode.CHUNK_INDEX, numbers, offsets, size, compression, _TWO.pack(*self[7:]))


_FOUR = struct.Struct("<QQQQ")
_TWO = struct.Struct("<QQ")


class AttachmentHead(NamedTuple):
    """What precedes the data of an attachment."""

    log_ns: int
    created_ns: int
    name: str
    media_type: str
    size: int

    @classmethod
    def read(cls, fields: Fields) -> AttachmentHead:
        """Return the head, after which `fields` has the data."""
        log_ns, created_ns = fields.numbers(_TWO)
        return cls(log_ns, created_ns, fields.text(), fields.text(), fields.number())

    def packed(self, data: bytes) -> bytes:
        """Return the record with these data and their checksum."""
        names = text(self.name) + text(self.media_type)
        content = _TWO.pack(self.log_ns, self.created_ns) + names + _U64.pack(self.size) + data
        return record(Opcode.ATTACHMENT, content, _U32.pack(crc32(content)))


class AttachmentIndex(NamedTuple):
    """Where an attachment is."""

    at: int
    length: int
    head: AttachmentHead

    @classmethod
    def read(cls, content: bytes) -> AttachmentIndex:
        """Return the index of a record's content."""
        fields = Fields(content)
        at, length = fields.numbers(_TWO)
        log_ns, created_ns = fields.numbers(_TWO)
        size, name, media_type = fields.number(), fields.text(), fields.text()
        return cls(at, length, AttachmentHead(log_ns, created_ns, name, media_type, size))

    def packed(self) -> bytes:
        """Return the record."""
        head = self.head
        numbers = (self.at, self.length, head.log_ns, head.created_ns)
        names = text(head.name) + text(head.media_type)
        return record(Opcode.ATTACHMENT_INDEX, _FOUR.pack(*numbers), _U64.pack(head.size), names)


class Metadata(NamedTuple):
    """Named texts."""

    name: str
    metadata: Mapping[str, str]

    @classmethod
    def read(cls, content: bytes) -> Metadata:
        """Return the metadata of a record's content."""
        fields = Fields(content)
        return cls(fields.text(), fields.texts())

    def packed(self) -> bytes:
        """Return the record."""
        return record(Opcode.METADATA, text(self.name), texts(self.metadata))


class MetadataIndex(NamedTuple):
    """Where metadata are."""

    at: int
    length: int
    name: str

    @classmethod
    def read(cls, content: bytes) -> MetadataIndex:
        """Return the index of a record's content."""
        fields = Fields(content)
        at, length = fields.numbers(_TWO)
        return cls(at, length, fields.text())

    def packed(self) -> bytes:
        """Return the record."""
        return record(Opcode.METADATA_INDEX, _TWO.pack(self.at, self.length), text(self.name))


class Statistics(NamedTuple):
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

    @classmethod
    def read(cls, content: bytes) -> Statistics:
        """Return the statistics of a record's content."""
        fields = Fields(content)
        messages, schemas, channels, *rest = fields.numbers(_STATISTICS)
        attachments, metadata, chunks, start_ns, end_ns = rest
        numbers = (messages, schemas, channels, attachments, metadata, chunks, start_ns, end_ns)
        return cls(*numbers, fields.counts())

    def packed(self) -> bytes:
        """Return the record."""
        numbers = _STATISTICS.pack(*self[:8])
        return record(Opcode.STATISTICS, numbers, counts(self.of_channels))


_STATISTICS = struct.Struct("<QHIIIIQQ")


class Footer(NamedTuple):
    """Where the summary begins; 0: there is none."""

    summary_at: int
    offsets_at: int
    summary_crc: int

    @classmethod
    def read(cls, content: bytes) -> Footer:
        """Return the footer of a record's content."""
        return cls(*Fields(content).numbers(_FOOTER))

    def packed(self) -> bytes:
        """Return the record."""
        return record(Opcode.FOOTER, _FOOTER.pack(*self))


_FOOTER = struct.Struct("<QQI")


def record(kind: Opcode, *parts: bytes) -> bytes:
    """Return a record of a kind."""
    return b"".join((RECORD.pack(kind, sum(map(len, parts))), *parts))


def text(value: str) -> bytes:
    """Return the field of a text."""
    return _sized(value.encode())


def texts(values: Mapping[str, str]) -> bytes:
    """Return the field of a map of texts."""
    return _sized(b"".join(text(key) + text(value) for key, value in values.items()))


def counts(values: Mapping[int, int]) -> bytes:
    """Return the field of a number for each channel."""
    return _sized(b"".join(_COUNT.pack(*pair) for pair in values.items()))


def message_index(channel: int, entries: Iterable[tuple[int, int]]) -> bytes:
    """Return the record with log time and position of each message of a channel in a chunk."""
    packed = _sized(b"".join(_TWO.pack(*entry) for entry in entries))
    return record(Opcode.MESSAGE_INDEX, _U16.pack(channel), packed)


def summary_offset(kind: Opcode, at: int, length: int) -> bytes:
    """Return the record that says where the records of a kind are in the summary."""
    return record(Opcode.SUMMARY_OFFSET, struct.pack("<BQQ", kind, at, length))


def _sized(data: bytes) -> bytes:
    return _U32.pack(len(data)) + data
