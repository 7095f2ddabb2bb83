"""Reads one MCAP file with limits, also a file that is damaged, or cut off by `kill -9`.

A damaged file may claim a length of 2^62, or hold a chunk that expands to gigabytes: every length
is checked against the file before anything is read, decompression is bounded, and only one chunk is
in memory. What cannot be read is in `notes`, with its position.

Format: mcap.dev/spec.
"""

from __future__ import annotations

import os
import re
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple
from zlib import crc32

from cairn.errors import RecordingError
from cairn.limits.compression import RECORD_BYTES, unpack
from cairn.limits.files import megabytes, open_regular
from cairn.recording.mcap_records import (
    MAGIC,
    MESSAGE,
    MESSAGE_OPCODE,
    RECORD,
    AttachmentIndex,
    AttachmentRecord,
    ChannelRecord,
    Chunk,
    ChunkIndex,
    DataEnd,
    Fields,
    Footer,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from cairn.system.closing import Closing
from cairn.system.files import explain_os_error, explained

MOST_CHANNELS: Final = 20_000
"""Channels of a file: a publisher has one for each topic, and a new one after each restart."""

MOST_BLOCKS: Final = 200_000
"""Chunks of a file: more than a day at one every 0.5 s."""

ALL_CHANNELS: Final = -1
"""The bits of all channels, in `Block.channels`."""

_DEFINITION_BYTES: Final = 64_000_000  # of schemas, channels and metadata together
_SUMMARY_BYTES: Final = 64_000_000
_METADATA_BYTES: Final = 1_000_000  # of one record
_LEAST_BYTES: Final = 1_000  # as which a shorter one counts
_MASK_BYTES: Final = 32_000_000  # of the bits of channels of all blocks
_MOST_NOTES: Final = 1_000
_MOST_ATTACHMENTS: Final = 1_000
_BLOCK_BYTES: Final = 4_000_000  # of messages outside of chunks that are read at once
_SMALL_BYTES: Final = 64_000_000
_RATIO: Final = 200  # grids and simulated images compress much better than those of cameras

Progress = Callable[[int, int], None]
"""Is called with the number of bytes that are done, and of all."""

_FOOTER: Final = RECORD.size + 20 + len(MAGIC)
_ATTACHMENT_HEAD: Final = 4096
_INVALID: Final = (ValueError, struct.error, OverflowError)
_TRANSIENT: Final = re.compile(r"durability: *['\"]?(?:1|transient_local)\b")


@dataclass(frozen=True)
class RecordedChannel:
    """A topic of one publisher; of files that Cairn did not write, a topic.

    `type` is that of ROS 2, such as `sensor_msgs/msg/LaserScan`. `schema` is its definition in
    `schema_encoding`, as a rule `ros2msg`.
    """

    topic: str
    type: str
    encoding: str = "cdr"
    schema_encoding: str = "ros2msg"
    schema: bytes = b""
    metadata: tuple[tuple[str, str], ...] = ()

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        # Of all fields: 20,000 channels of one topic with equal hashes would take minutes.
        return hash((self.topic, self.type, self.encoding, self.schema, self.metadata))

    @cached_property
    def node(self) -> str:
        """The publisher's full name, `/robot/localizer`; "" if it is not recorded."""
        return dict(self.metadata).get("node", "")

    @cached_property
    def gid(self) -> str:
        """The publisher's identity in hexadecimal; "" if it is not recorded."""
        return dict(self.metadata).get("gid", "")

    @cached_property
    def type_hash(self) -> str:
        """The type's hash (RIHS01_...); "" if it is not recorded."""
        return dict(self.metadata).get("type_hash", "")

    @cached_property
    def latched(self) -> bool:
        """Whether late subscribers get the last message."""
        metadata = dict(self.metadata)
        if "latched" in metadata:
            return metadata["latched"] == "true"
        return _TRANSIENT.search(metadata.get("offered_qos_profiles", "")) is not None


class RecordedMessage(NamedTuple):
    """A recorded message: `data` as on the wire, its times in ns.

    `log_ns` is when it arrived at the recorder, `publish_ns` when it was sent; `sequence` is its
    number (the lowest 32 bits) of its publisher.
    """

    channel: RecordedChannel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


@dataclass(frozen=True)
class RecordedAttachment:
    """A file that is attached to a recording; `at` is its byte in `path`."""

    name: str
    media_type: str
    log_ns: int
    size: int
    path: Path
    at: int


class Block(NamedTuple):
    """A chunk, or messages outside of chunks: bytes `at` to `end` of the file, times [ns].

    `channels` has a bit for each channel of which it has messages; -1 if that is not known.
    `size` is that of its records, decompressed, -1 if it is not known.
    """

    at: int
    end: int
    start_ns: int
    end_ns: int
    channels: int
    size: int = -1


class _MessageEntry(NamedTuple):
    """A message in a block: the number of its channel, its times [ns] and where its data are."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    begin: int
    end: int


class _Record(NamedTuple):
    kind: int
    at: int
    begin: int
    end: int


class _CutOffError(ValueError):
    """The file ends within a record, or has no record where one has to be.

    `at` is the byte of a record of which the file has only the beginning.
    """

    def __init__(self, text: str, at: int | None = None) -> None:
        super().__init__(text)
        self.at = at


@dataclass
class _Definitions:
    """The channels of a file. Their numbers are those of `all`, not the file's ids."""

    path: Path
    all: list[RecordedChannel] = field(default_factory=list)
    ids: dict[int, int] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    size: int = 0

    def add_schema(self, content: bytes) -> None:
        schema = Schema.read(content)
        known = self.schemas.setdefault(schema.id, schema)
        if known is schema:
            self.count(len(content))
        elif known != schema:
            raise ValueError(f"schema {schema.id} is defined twice, differently")

    def add_channel(self, content: bytes) -> None:
        found = ChannelRecord.read(content)
        schema = self.schemas.get(found.schema_id)
        if schema is None and found.schema_id:
            raise ValueError(f"channel {found.id} has schema {found.schema_id}, which is missing")
        channel = RecordedChannel(
            found.topic,
            schema.name if schema else "",
            found.message_encoding,
            schema.encoding if schema else "",
            schema.data if schema else b"",
            tuple(sorted(found.metadata.items())),
        )
        if found.id not in self.ids:
            self.ids[found.id] = len(self.all)
            self.all.append(channel)
            self.count(len(content))
        elif self.all[self.ids[found.id]] != channel:
            raise ValueError(f"channel {found.id} is defined twice, differently")

    def count(self, size: int) -> None:
        self.size += size
        if self.size > _DEFINITION_BYTES or len(self.all) > MOST_CHANNELS:
            raise RecordingError(
                f"{self.path}: defines more than {MOST_CHANNELS:,} channels, or more than "
                f"{megabytes(_DEFINITION_BYTES)} MB of schemas and metadata, which is the limit"
            )


def holds_mcap(path: Path) -> bool:
    """Return whether a path is an MCAP file, or a folder with `*.mcap` files."""
    if path.is_dir():
        return next(path.glob("*.mcap"), None) is not None
    try:
        with open_regular(path) as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


class McapFile(Closing):
    """One MCAP file, open for reading; use it in a `with` statement.

    `notes` are sentences about what could not be read. A file that was cut off is read up to there.
    """

    def __init__(self, path: Path) -> None:
        """Open a file; raise `RecordingError` if it is not an MCAP file or cannot be read."""
        self.path = path
        self.notes: list[str] = []
        self.attachments: list[RecordedAttachment] = []
        self.metadata: dict[str, dict[str, str]] = {}
        self._definitions = _Definitions(path)
        self._counts: Counter[int] = Counter()
        self._unpacked = 0
        self._masks: dict[int, int] = {}
        self._mask_bytes = 0
        with explained(f"{path}: cannot be read", RecordingError):
            self._stream: BinaryIO = open_regular(path)
            self.size = os.fstat(self._stream.fileno()).st_size
            magic = self._stream.read(len(MAGIC))
        if magic != MAGIC:
            self._stream.close()
            raise RecordingError(
                f"{path}: is not an MCAP file, it starts with {magic!r}; give an MCAP file"
            )

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def channels(self) -> list[RecordedChannel]:
        """The channels that are known so far: all after `index`."""
        return self._definitions.all

    @property
    def counts(self) -> Counter[RecordedChannel]:
        """The messages of each channel, among those read by `messages`, or all after `index`."""
        counts = Counter(dict.fromkeys(self.channels, 0))
        for number, count in self._counts.items():
            counts[self.channels[number]] += count
        return counts

    def bits(self, channels: Collection[RecordedChannel]) -> int:
        """Return the bits of channels in `Block.channels`."""
        return sum(1 << k for k, channel in enumerate(self.channels) if channel in channels)

    def messages(self, wanted: Callable[[RecordedChannel], bool]) -> Iterator[RecordedMessage]:
        """Yield the messages of the wanted channels in the order of the file; count all of them.

        Nothing but the messages and definitions themselves is used: no index, no summary.
        """
        chosen: dict[int, bool] = {}
        for record, data, entries in self._blocks():
            with self._noted(record.at):
                for entry in entries:
                    self._counts[entry.channel] += 1
                    channel = self.channels[entry.channel]
                    if entry.channel not in chosen:
                        chosen[entry.channel] = wanted(channel)
                    if chosen[entry.channel]:
                        yield _message(channel, entry, data)

    def load(
        self, block: Block, channels: int, start_ns: int = 0, end_ns: int = 2**64
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of a block, of channels by their bits, from `start_ns` to `end_ns`."""
        with self._noted(block.at):
            data = self._bytes_of(block)
            for entry in self._entries(data, block.at):
                if start_ns <= entry.log_ns <= end_ns and channels >> entry.channel & 1:
                    yield _message(self.channels[entry.channel], entry, data)

    def index(self, progress: Progress | None = None) -> list[Block]:
        """Return the blocks of the file; then channels, counts, attachments, metadata are known.

        The summary at the end of the file is used if it is there and whole; otherwise the whole
        file is read, and `progress` is called.
        """
        try:
            blocks = self._summary()
        except (*_INVALID, RecordingError) as error:
            self._note(f"its summary is damaged ({error}), so it was not used")
            blocks = None
        if blocks is not None:
            return blocks
        self._definitions = _Definitions(self.path)
        self._counts.clear()
        self.attachments.clear()
        self.metadata.clear()
        return list(self._scan(progress))

    def read_attachment(self, attachment: RecordedAttachment) -> bytes:
        """Return the content of an attachment; raise `RecordingError` if it is damaged."""
        try:
            record = self._record(attachment.at)
            if record.kind != AttachmentRecord.OPCODE:
                raise ValueError("there is another record")
            content = self._content(record)
            found = AttachmentRecord.read(content)
            if len(found.data) != attachment.size or found.name != attachment.name:
                raise ValueError("it is another one than the index describes")
            if found.crc and crc32(content[:-4]) != found.crc:
                raise ValueError("its checksum differs")
        except _INVALID as error:
            raise RecordingError(
                f"{self.path}: the attachment {attachment.name} at byte {attachment.at} cannot be "
                f"read: {error}; take a fresh copy of the file"
            ) from error
        return found.data

    # --- Records --------------------------------------------------------------------------------

    def _record(self, at: int, *, cut_off: bool = False) -> _Record:
        """Return the record at a byte of the file, with `cut_off` also one that ends after it."""
        begin = at + RECORD.size
        if begin > self.size:
            raise _CutOffError(f"at byte {at:,}: the file ends within a record")
        kind, size = RECORD.unpack(self._read(at, RECORD.size))
        if not kind:
            raise _CutOffError(f"at byte {at:,}: there is no record")
        if size > self.size - begin and not cut_off:
            raise _CutOffError(
                f"at byte {at:,}: a record claims {size:,} bytes, {self.size - begin:,} follow", at
            )
        return _Record(kind, at, begin, begin + size)

    def _records(self, at: int, end: int) -> Iterator[_Record]:
        while at < end:
            record = self._record(at)
            yield record
            at = record.end

    def _content(self, record: _Record) -> bytes:
        size = record.end - record.begin
        if size > RECORD_BYTES:
            raise ValueError(f"it has {megabytes(size)} MB, above {megabytes(RECORD_BYTES)} MB")
        return self._read(record.begin, size)

    def _read(self, at: int, size: int) -> bytes:
        try:
            self._stream.seek(at)
            data = self._stream.read(size)
        except OSError as error:
            raise RecordingError(
                f"{self.path}: byte {at} cannot be read: {explain_os_error(error)}"
            ) from error
        if len(data) < size:
            raise _CutOffError(f"at byte {at:,}: the file became shorter")
        return data

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)
        if len(self.notes) > _MOST_NOTES:
            raise RecordingError(
                f"{self.path}: has more than {_MOST_NOTES:,} damages, the last: {text}; repair it "
                f"with `mcap recover {self.path.name}`, or take a fresh copy"
            )

    def _noted(self, at: int) -> _Noted:
        return _Noted(self, at)

    # --- Blocks ---------------------------------------------------------------------------------

    def _blocks(
        self, others: Callable[[_Record], None] | None = None
    ) -> Iterator[tuple[_Record, bytes, Iterator[_MessageEntry]]]:
        """Yield chunks, and runs of messages outside of chunks, with their data and messages."""
        self._unpacked = 0
        run: _Record | None = None
        try:
            for record in self._records(len(MAGIC), self.size):
                if record.kind in (MESSAGE_OPCODE, Schema.OPCODE, ChannelRecord.OPCODE):
                    if run is None:
                        run = _Record(MESSAGE_OPCODE, record.at, record.at, record.at)
                    run = run._replace(end=record.end)
                    if run.end - run.at < _BLOCK_BYTES:
                        continue
                if run is not None:
                    yield from self._block(run)
                    run = None
                if record.kind == Chunk.OPCODE:
                    yield from self._block(record)
                elif record.kind == DataEnd.OPCODE:
                    self._check_end()
                    return
                elif others is not None:
                    with self._noted(record.at):
                        others(record)
            raise _CutOffError(f"after byte {self.size:,}: it was not closed")
        except _CutOffError as error:
            if run is not None:
                yield from self._block(run)
            self._note(f"cut off {error}")
            last = None if error.at is None else self._record(error.at, cut_off=True)
            if last is not None and last.kind == Chunk.OPCODE:
                yield from self._block(last._replace(end=self.size))

    def _block(self, record: _Record) -> Iterator[tuple[_Record, bytes, Iterator[_MessageEntry]]]:
        with self._noted(record.at):
            data = self._bytes_of(
                Block(record.at, record.end, 0, 0, ALL_CHANNELS), unpacked=self._unpacked
            )
            self._unpacked += len(data)
            yield record, data, self._entries(data, record.at)

    def _check_unpacked(self, size: int) -> None:
        most = max(_SMALL_BYTES, _RATIO * self.size)
        if size > most:
            raise RecordingError(
                f"{self.path}: unpacks to more than {megabytes(most)} MB, the limit for a file "
                f"of its size ({megabytes(_SMALL_BYTES)} MB, or {_RATIO} times the size); if "
                "it is genuine, decompress it with `mcap compress --compression none`"
            )

    def _bytes_of(self, block: Block, *, unpacked: int = 0) -> bytes:
        """Return the records of a block, decompressed.

        `unpacked` bytes came before it: what is too much with them is not decompressed.
        """
        record = self._record(block.at, cut_off=True)
        if record.kind != Chunk.OPCODE:
            size = block.end - block.at
            if not 0 < size <= _BLOCK_BYTES + RECORD_BYTES or block.end > self.size:
                raise ValueError("there is no chunk")
            return self._read(block.at, size)
        is_cut_off = record.end > self.size
        content = self._content(record._replace(end=min(record.end, self.size)))
        chunk = Chunk.read_cut_off(content) if is_cut_off else Chunk.read(content)
        if block.size not in (-1, chunk.uncompressed_size):
            raise ValueError(f"it unpacks to {chunk.uncompressed_size:,} bytes, not {block.size:,}")
        self._check_unpacked(unpacked + chunk.uncompressed_size)
        data = unpack(chunk.data, chunk.compression, chunk.uncompressed_size, cut_off=is_cut_off)
        if is_cut_off:
            return _whole_records(data)
        if chunk.uncompressed_crc and crc32(data) != chunk.uncompressed_crc:
            raise ValueError("its checksum differs")
        return data

    def _entries(self, data: bytes, where: int) -> Iterator[_MessageEntry]:
        """Yield the messages in `data` of the block at byte `where`; add the definitions."""
        at, end = 0, len(data)
        ids = self._definitions.ids
        unpack_record, unpack_message = RECORD.unpack_from, MESSAGE.unpack_from
        while at < end:
            if at + RECORD.size > end:
                raise ValueError("it ends within a record")
            kind, size = unpack_record(data, at)
            begin = at + RECORD.size
            at = begin + size
            if at > end:
                raise ValueError(f"a record claims {size:,} bytes, {end - begin:,} follow")
            if kind == MESSAGE_OPCODE:
                if size < MESSAGE.size:
                    raise ValueError(f"a message has {size} bytes, less than its head")
                channel, sequence, log_ns, publish_ns = unpack_message(data, begin)
                if channel in ids:
                    yield _MessageEntry(
                        ids[channel], sequence, log_ns, publish_ns, begin + MESSAGE.size, at
                    )
                else:
                    self._note(f"messages belong to channel {channel}, which is not defined")
            elif kind in (Schema.OPCODE, ChannelRecord.OPCODE):
                add = (
                    self._definitions.add_schema
                    if kind == Schema.OPCODE
                    else self._definitions.add_channel
                )
                with self._noted(where):
                    add(data[begin:at])
            elif kind == Chunk.OPCODE:
                raise ValueError("it holds a chunk")

    def _check_end(self) -> None:
        if self._read(self.size - len(MAGIC), len(MAGIC)) != MAGIC:
            raise _CutOffError(f"after byte {self.size:,}: its end is missing")

    # --- Index ----------------------------------------------------------------------------------

    def _scan(self, progress: Progress | None) -> Iterator[Block]:
        count = 0
        for record, _, entries in self._blocks(self._describe):
            channels, start_ns, end_ns = 0, 2**64, 0
            counts: Counter[int] = Counter()
            with self._noted(record.at):
                for entry in entries:
                    counts[entry.channel] += 1
                    start_ns = min(start_ns, entry.log_ns)
                    end_ns = max(end_ns, entry.log_ns)
            for number, messages in counts.items():
                channels |= 1 << number
                self._counts[number] += messages
            if counts:
                count += 1
                self._check_blocks(count)
                yield Block(record.at, record.end, start_ns, end_ns, self._mask(channels))
            if progress is not None:
                progress(record.end, self.size)

    def _mask(self, channels: int) -> int:
        """Return the bits of channels; of many different ones, those of all channels."""
        known = self._masks.get(channels)
        if known is None:
            self._mask_bytes += channels.bit_length() // 8
            if self._mask_bytes > _MASK_BYTES:
                return ALL_CHANNELS
            known = self._masks[channels] = channels
        return known

    def _check_blocks(self, count: int) -> None:
        if count > MOST_BLOCKS:
            raise RecordingError(
                f"{self.path}: has more than {MOST_BLOCKS:,} chunks, which is the limit; split it"
            )

    def _describe(self, record: _Record) -> None:
        """Keep an attachment's description, or metadata."""
        if record.kind == AttachmentRecord.OPCODE:
            size = record.end - record.begin
            content = self._read(record.begin, min(size, _ATTACHMENT_HEAD))
            self._attach(record.at, *Fields(content).take(AttachmentRecord.HEAD))
        elif record.kind == Metadata.OPCODE:
            if record.end - record.begin > _METADATA_BYTES:
                raise ValueError(f"metadata of more than {megabytes(_METADATA_BYTES)} MB")
            content = self._content(record)
            found = Metadata.read(content)
            self._definitions.count(max(_LEAST_BYTES, len(content)))
            self.metadata[found.name] = dict(found.metadata)  # the last one of a name counts

    def _attach(
        self, at: int, log_ns: int, _created_ns: int, name: str, media_type: str, size: int
    ) -> None:
        if len(self.attachments) >= _MOST_ATTACHMENTS:
            raise RecordingError(
                f"{self.path}: has more than {_MOST_ATTACHMENTS:,} attachments, which is the limit"
            )
        self.attachments.append(RecordedAttachment(name, media_type, log_ns, size, self.path, at))

    def _summary(self) -> list[Block] | None:
        """Return the blocks by the summary at the end of the file, None if there is none."""
        footer_at = self.size - _FOOTER
        if footer_at < len(MAGIC) or self._read(self.size - len(MAGIC), len(MAGIC)) != MAGIC:
            return None  # the scan finds out where it is cut off
        record = self._record(footer_at)
        if record.kind != Footer.OPCODE:
            raise ValueError("there is no footer")
        footer = Footer.read(self._content(record))
        begin = footer.summary_at
        if not begin:
            return None
        if not len(MAGIC) <= begin <= footer_at or footer_at - begin > _SUMMARY_BYTES:
            raise ValueError(f"it claims to begin at byte {begin:,}")
        summary = self._read(begin, footer_at + RECORD.size + 16 - begin)
        if footer.summary_crc and crc32(summary) != footer.summary_crc:
            raise ValueError("its checksum differs")
        statistics, indexes = self._summarized(summary[: footer_at - begin])
        if (
            statistics is None
            or len(indexes) != statistics.chunks
            or len(self.channels) != statistics.channels
            or len(self.attachments) != statistics.attachments
            or sum(statistics.of_channels.values()) != statistics.messages
            or (statistics.messages and not indexes)
        ):
            return None  # a writer may leave them out
        ids = self._definitions.ids
        numbers = {*statistics.of_channels}.union(*(one.message_indexes for one in indexes))
        if not numbers <= ids.keys():
            raise ValueError("it names channels that it does not define")
        for number, count in statistics.of_channels.items():
            self._counts[ids[number]] += count
        blocks = [
            Block(
                one.chunk_at,
                one.chunk_at + one.chunk_length,
                one.start_ns,
                one.end_ns,
                self._mask(sum(1 << ids[number] for number in one.message_indexes) or ALL_CHANNELS),
                one.uncompressed_size,
            )
            for one in indexes
        ]
        # Otherwise a small file could name a chunk many times, and take any time to read.
        if any(after.at < before.end for before, after in pairwise(sorted(blocks))):
            raise ValueError("it names a chunk twice, or chunks that overlap")
        self._check_unpacked(sum(block.size for block in blocks))
        return blocks

    def _summarized(self, summary: bytes) -> tuple[Statistics | None, list[ChunkIndex]]:
        """Read definitions, statistics, attachments, metadata and chunks from a summary."""
        statistics: Statistics | None = None
        indexes: list[ChunkIndex] = []
        described: set[int] = set()
        at = 0
        while at < len(summary):
            if at + RECORD.size > len(summary):
                raise ValueError("it ends within a record")
            kind, size = RECORD.unpack_from(summary, at)
            begin = at + RECORD.size
            at = begin + size
            if at > len(summary):
                raise ValueError(f"a record claims {size:,} bytes, {len(summary) - begin:,} follow")
            content = summary[begin:at]
            if kind == Schema.OPCODE:
                self._definitions.add_schema(content)
            elif kind == ChannelRecord.OPCODE:
                self._definitions.add_channel(content)
            elif kind == Statistics.OPCODE:
                statistics = Statistics.read(content)
            elif kind == ChunkIndex.OPCODE:
                indexes.append(ChunkIndex.read(content))
                self._check_blocks(len(indexes))
            elif kind == AttachmentIndex.OPCODE:
                one = AttachmentIndex.read(content)
                self._attach(one.at, one.log_ns, one.created_ns, one.name, one.media_type, one.size)
            elif kind == MetadataIndex.OPCODE:
                index = MetadataIndex.read(content)
                if index.at in described:
                    raise ValueError(f"it names the metadata at byte {index.at:,} twice")
                described.add(index.at)
                self._describe(self._record(index.at))
        return statistics, indexes


class _Noted:
    """Turns an error about what is at a byte of the file into a note."""

    def __init__(self, file: McapFile, at: int) -> None:
        self._file, self._at = file, at

    def __enter__(self) -> None:
        return None

    def __exit__(self, _: object, error: BaseException | None, __: object) -> bool:
        if isinstance(error, _INVALID):
            self._file._note(f"damaged at byte {self._at:,}: {error or type(error).__name__}")
            return True
        return False


def _whole_records(data: bytes) -> bytes:
    """Return data without a record at the end of which only the beginning is there."""
    at = end = 0
    while end <= len(data):
        at = end
        if at + RECORD.size > len(data):
            break
        end = at + RECORD.size + RECORD.unpack_from(data, at)[1]
    return data[:at]


def _message(channel: RecordedChannel, entry: _MessageEntry, data: bytes) -> RecordedMessage:
    return RecordedMessage(
        channel, entry.sequence, entry.log_ns, entry.publish_ns, data[entry.begin : entry.end]
    )
