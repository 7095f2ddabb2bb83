"""Writes a part of a recording, or several recordings, into one file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from cairn.errors import RecordingError
from cairn.recording.mcap_file import Progress, RecordedChannel, RecordedMessage
from cairn.recording.mcap_writer import McapWriter
from cairn.recording.reader import McapRecording, RepeatedMessages
from cairn.system.files import explained, replacing


def rewrite(
    recording: McapRecording,
    out: Path,
    start_ns: int = 0,
    end_ns: int = 2**64,
    channels: Collection[RecordedChannel] | None = None,
    progress: Progress | None = None,
    *,
    wanted: Callable[[RecordedMessage], bool] | None = None,
    attachments: Mapping[str, bytes] | None = None,
    metadata: Mapping[str, Mapping[str, str]] | None = None,
) -> int:
    """Write the messages from `start_ns` to `end_ns` of some channels, and all attachments.

    Of the messages only those that are `wanted`, if it is given. Given `attachments` replace those
    of the recording, and `metadata` is added to its own.

    What latched topics held at `start_ns` is at the begin, as in every file of the recorder.
    Messages are in order of time. The file appears when it is complete. Returns the number of
    messages; raises `RecordingError` if it cannot be written.
    """
    with (
        explained(f"{out}: cannot be written", RecordingError),
        replacing(out) as part,
        part.open("wb") as stream,
    ):
        writer = _CopyWriter(McapWriter(stream.write, "cairn"))
        writer.begin(recording, attachments, metadata or {})
        latched = recording.latched_at(start_ns - 1, channels) if start_ns else []
        for message in latched:
            writer.add(message._replace(log_ns=start_ns))
        for message in recording.messages(start_ns, end_ns, channels, progress):
            if wanted is None or wanted(message):
                writer.add(message)
        return writer.finish()


class _CopyWriter:
    """Writes messages with their channels as they were recorded."""

    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._channels: dict[RecordedChannel, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._repeats = RepeatedMessages()
        self._now = -1
        self._of_now: set[tuple[RecordedChannel, int, int]] = set()
        self._count = 0

    def begin(
        self,
        recording: McapRecording,
        attachments: Mapping[str, bytes] | None,
        metadata: Mapping[str, Mapping[str, str]],
    ) -> None:
        """Write attachments and metadata; those of equal content once."""
        written: set[tuple[str, bytes]] = set()
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, name, "application/octet-stream", data)
        for one in recording.attachments if attachments is None else ():
            data = recording.read_attachment(one)
            key = (one.name, hashlib.sha256(data).digest())
            if key not in written:
                written.add(key)
                self._writer.add_attachment(one.log_ns, one.name, one.media_type, data)
        for name, values in {**recording.metadata, **metadata}.items():
            self._writer.add_metadata(name, dict(values))

    def add(self, message: RecordedMessage) -> None:
        """Write a message, if it is not a repeated one, or in several files that overlap."""
        if self._repeats.contains(message):
            return
        if message.log_ns != self._now:
            self._now = message.log_ns
            self._of_now.clear()
        if message.channel.gid:
            identity = (message.channel, message.sequence, message.publish_ns)
            if identity in self._of_now:
                return
            self._of_now.add(identity)
        channel = self._channels.get(message.channel)
        if channel is None:
            channel = self._channels[message.channel] = self._register(message.channel)
        self._writer.add_message(
            channel, message.sequence, message.log_ns, message.publish_ns, message.data
        )
        self._count += 1

    def finish(self) -> int:
        """Write the summary; return the number of messages."""
        self._writer.finish()
        return self._count

    def _register(self, channel: RecordedChannel) -> int:
        schema = 0
        if channel.type or channel.schema:
            key = (channel.type, channel.schema_encoding, channel.schema)
            if key not in self._schemas:
                self._schemas[key] = self._writer.add_schema(*key)
            schema = self._schemas[key]
        return self._writer.add_channel(
            channel.topic, channel.encoding, schema, dict(channel.metadata)
        )
