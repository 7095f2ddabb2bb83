"""Writes MCAP files: messages in compressed chunks, and at the end the index of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from zlib import crc32

from cairn.limits.compression import pack
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
    Footer,
    HeaderRecord,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

_CHUNK_BYTES = 1 << 20


class McapWriter:
    """One MCAP file that is being written; `write` takes its bytes, from the first to the last."""

    def __init__(
        self,
        write: Callable[[bytes], object],
        library: str,
        *,
        compression: str = "zstd",
        chunk_bytes: int = _CHUNK_BYTES,
    ) -> None:
        """Write the header, with the profile of ROS 2 and the name of the writing `library`.

        `compression` of the chunks is "zstd", "lz4" or "none"; they end after `chunk_bytes`.
        """
        self._output = write
        self._compression = compression
        self._chunk_bytes = chunk_bytes
        self._at = 0
        self._schemas: list[Schema] = []
        self._channels: list[ChannelRecord] = []
        self._chunk = bytearray()
        self._entries: dict[int, list[tuple[int, int]]] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._write(MAGIC)
        self._write(HeaderRecord("ros2", library).packed())

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add the definition of a message type; return its number."""
        schema = Schema(len(self._schemas) + 1, name, encoding, data)
        self._schemas.append(schema)
        self._chunk += schema.packed()
        return schema.id

    def add_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Add a topic whose messages have a schema, 0 for none; return its number."""
        channel = ChannelRecord(len(self._channels) + 1, schema, topic, encoding, dict(metadata))
        self._channels.append(channel)
        self._chunk += channel.packed()
        return channel.id

    def add_message(
        self, channel: int, sequence: int, log_ns: int, publish_ns: int, data: bytes
    ) -> None:
        """Add a message to the chunk."""
        head = RECORD.pack(MESSAGE_OPCODE, MESSAGE.size + len(data))
        body = MESSAGE.pack(channel, sequence, log_ns, publish_ns)
        self._entries.setdefault(channel, []).append((log_ns, len(self._chunk)))
        self._chunk += head + body
        self._chunk += data
        self._counts[channel] += 1
        if len(self._chunk) > self._chunk_bytes:
            self.end_chunk()

    def add_attachment(self, log_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Attach a file, which was created at `log_ns`."""
        attachment = AttachmentRecord(log_ns, log_ns, name, media_type, data)
        content = attachment.packed()[RECORD.size : -4]
        at, length = self._write(replace(attachment, crc=crc32(content)).packed())
        self._attachments.append(
            AttachmentIndex(at, length, log_ns, log_ns, len(data), name, media_type)
        )

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Add named texts."""
        at, length = self._write(Metadata(name, metadata).packed())
        self._metadata.append(MetadataIndex(at, length, name))

    def end_chunk(self) -> None:
        """Write the chunk, if it has messages, and its index."""
        if not self._entries:
            return
        data = bytes(self._chunk)
        packed = pack(data, self._compression)
        name = "" if self._compression == "none" else self._compression
        times = [log_ns for entries in self._entries.values() for log_ns, _ in entries]
        start_ns, end_ns = min(times), max(times)
        chunk = Chunk(start_ns, end_ns, len(data), crc32(data), name, packed)
        at, length = self._write(chunk.packed())
        begin = self._at
        indexes = {
            channel: self._write(MessageIndex(channel, entries).packed())[0]
            for channel, entries in self._entries.items()
        }
        self._chunks.append(
            ChunkIndex(
                start_ns, end_ns, at, length, indexes, self._at - begin, name, len(packed),
                len(data),
            )
        )  # fmt: skip
        self._chunk.clear()
        self._entries.clear()

    def finish(self) -> None:
        """Write the chunk and the summary of the file, after which nothing can be added."""
        self.end_chunk()
        self._write(DataEnd().packed())
        summary_at = self._at
        summary, offsets = bytearray(), bytearray()
        groups: tuple[Sequence[McapRecord], ...] = (
            self._schemas,
            self._channels,
            [self._statistics()],
            self._chunks,
            self._attachments,
            self._metadata,
        )
        for records in filter(None, groups):
            group = b"".join(one.packed() for one in records)
            at = summary_at + len(summary)
            offsets += SummaryOffset(records[0].OPCODE, at, len(group)).packed()
            summary += group
        offsets_at = summary_at + len(summary)
        summary += offsets
        # The checksum covers the footer up to itself.
        head = Footer(summary_at, offsets_at, 0).packed()[:-4]
        footer = Footer(summary_at, offsets_at, crc32(head, crc32(summary)))
        self._write(bytes(summary) + footer.packed() + MAGIC)

    def _statistics(self) -> Statistics:
        numbers = (
            sum(self._counts.values()), len(self._schemas), len(self._channels),
            len(self._attachments), len(self._metadata), len(self._chunks),
        )  # fmt: skip
        start_ns = min((one.start_ns for one in self._chunks), default=0)
        end_ns = max((one.end_ns for one in self._chunks), default=0)
        return Statistics(*numbers, start_ns, end_ns, self._counts)

    def _write(self, data: bytes) -> tuple[int, int]:
        """Write bytes; return their position and length."""
        at = self._at
        self._output(data)
        self._at += len(data)
        return at, len(data)
