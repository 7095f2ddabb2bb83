"""The MCAP file of a recording: its format, and how it stays readable whatever happens.

The format is that of rosbag2 (profile `ros2`, CDR with `ros2msg` definitions), with one channel for
each topic and publisher. `McapWriter` makes the bytes; this module hands them to the system in one
piece for each chunk, so that a file whose writer was killed ends after a complete record, and so
that a full disk loses nothing: what it did not take is written when it has space again.
"""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal

import yaml

from cairn.bus.qos import Qos
from cairn.bus.type_hash import definition, type_hash
from cairn.recording.mcap_writer import McapWriter
from cairn.recording.tap import PublisherInfo, Sample

Compression = Literal["zstd", "lz4", "none"]
FindMessage = Callable[[str], type[Any] | None]
"""Returns the message class of a type name; None if it is not known."""

FORMAT_VERSION: Final = "1"
FORMAT_RECORD: Final = "cairn"
"""Name of the metadata record with the version of this format."""
LOSSES_RECORD: Final = "cairn_losses"
"""Name of the metadata records with the messages that are missing, by topic; the last one counts.

Keys are `dropped TOPIC`, which the recorder had no memory for, and `lost TOPIC`, which did not
reach it.
"""
MAX_CHANNELS: Final = 10_000
"""Channels of one file; its reader accepts twice as many."""

_LIBRARY = f"cairn {version('cairn-robotics')}"
_CHUNK_BYTES = 4 << 20
_RELIABILITY = {"reliable": 1, "best_effort": 2}
_DURABILITY = {"transient_local": 1, "volatile": 2}
_UNLIMITED = {"sec": 2147483647, "nsec": 4294967295}


class RecordingFile:
    """One MCAP file that is being written; from one thread at a time."""

    def __init__(
        self,
        path: Path,
        started_ns: int,
        attachments: Mapping[str, bytes],
        find_message: FindMessage,
        *,
        compression: Compression,
        keep_free: int,
        metadata: Mapping[str, str],
    ) -> None:
        """Create the file, which must not exist; raises `OSError`.

        Args:
            path: of the file.
            started_ns: time of its beginning [ns].
            attachments: files to attach, by name.
            find_message: finds the definitions of message types.
            compression: of the chunks.
            keep_free: space that is left free on the disk [bytes].
            metadata: further entries of the metadata record `cairn`.
        """
        self.path = path
        self.started_ns = started_ns
        self.messages = 0
        self.unsaved: Counter[str] = Counter()
        """Messages that the disk has not taken yet, by topic."""
        self._find_message = find_message
        self._output = _Output(path, keep_free)
        self._writer = McapWriter(
            self._output.write, _LIBRARY, compression=compression, chunk_bytes=_CHUNK_BYTES
        )
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[tuple[str, bytes, str], int] = {}
        self._writer.add_metadata(FORMAT_RECORD, {"format": FORMAT_VERSION, **metadata})
        for name, data in attachments.items():
            kind = "application/json" if name.endswith(".json") else "application/octet-stream"
            self._writer.add_attachment(started_ns, name, kind, data)

    @property
    def size(self) -> int:
        """Length of the file so far [bytes], with what the disk has not taken yet."""
        return self._output.size

    def has_channel(self, sample: Sample) -> bool:
        """Return whether a message of the same topic and publisher was added before."""
        return _channel_key(sample) in self._channels

    def add(self, sample: Sample, publisher: PublisherInfo | None, log_ns: int) -> bool:
        """Add a message; return False if it would need one channel too many.

        It is in the file after `save`.
        """
        key = _channel_key(sample)
        channel = self._channels.get(key)
        if channel is None:
            if len(self._channels) >= MAX_CHANNELS:
                return False
            channel = self._channels[key] = self._add_channel(sample, publisher)
        self._writer.add_message(
            channel,
            sample.sequence & 0xFFFF_FFFF,
            log_ns,
            max(0, sample.sent_ns),  # a foreign publisher may send any
            sample.payload,
        )
        self.messages += 1
        self.unsaved[sample.topic] += 1
        return True

    def add_losses(self, dropped: Mapping[str, int], lost: Mapping[str, int]) -> None:
        """Note how many messages are missing so far, by topic."""
        numbers = {f"dropped {topic}": str(count) for topic, count in sorted(dropped.items())}
        numbers |= {f"lost {topic}": str(count) for topic, count in sorted(lost.items())}
        self._writer.add_metadata(LOSSES_RECORD, numbers)

    def save(self) -> None:
        """Close the chunk and hand all of the file to the system.

        Raises `OSError` if the disk does not take it; the file then ends where it ended before, and
        the next call tries again.
        """
        self._writer.end_chunk()
        self._output.save()
        self.unsaved.clear()

    def close(self) -> None:
        """Write the index and close the file; raises `OSError` as `save` does.

        Then the file has no index, and readers read it from the beginning.
        """
        try:
            self.save()
            self._writer.finish()
            self._output.save()
        finally:
            self._output.close()

    def _add_channel(self, sample: Sample, publisher: PublisherInfo | None) -> int:
        schema = self._schemas.get((sample.type_name, sample.type_hash))
        if schema is None:
            message = self._find_message(sample.type_name)
            known = message is not None and type_hash(message) == sample.type_hash
            text = definition(message) if known and message is not None else ""
            schema = self._writer.add_schema(sample.type_name, "ros2msg", text.encode())
            self._schemas[sample.type_name, sample.type_hash] = schema
        latched = publisher is not None and publisher.qos.latched
        metadata = {
            "node": publisher.node if publisher is not None else "",
            "gid": sample.gid.hex(),
            "type_hash": sample.type_hash,
            "offered_qos_profiles": _qos_profiles(publisher.qos) if publisher else "",
            "latched": "true" if latched else "false",
        }
        return self._writer.add_channel(sample.topic, "cdr", schema, metadata)


class _Output:
    """What the writer writes to: keeps it in memory until `save` hands it to the system."""

    def __init__(self, path: Path, keep_free: int) -> None:
        self._keep_free = keep_free
        self._pending = bytearray()
        self._saved = 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)

    def write(self, data: bytes) -> None:
        self._pending += data

    @property
    def size(self) -> int:
        """Length of the file with what is not saved yet [bytes]."""
        return self._saved + len(self._pending)

    def save(self) -> None:
        if not self._pending:
            return
        disk = os.fstatvfs(self._descriptor)
        if disk.f_bavail * disk.f_frsize - len(self._pending) < self._keep_free:
            raise OSError(errno.ENOSPC, f"less than {self._keep_free >> 20} MiB are free")
        end = self._saved
        try:
            with memoryview(self._pending) as pending:
                while end - self._saved < len(pending):
                    end += os.pwrite(self._descriptor, pending[end - self._saved :], end)
        except OSError:
            with suppress(OSError):  # the file ends after a complete record
                os.ftruncate(self._descriptor, self._saved)
            raise
        self._saved = end
        self._pending.clear()

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _qos_profiles(qos: Qos) -> str:
    """Return a QoS as rosbag2 writes it into the metadata of a channel (YAML)."""
    profile = {
        "history": 1,  # keep last
        "depth": qos.depth,
        "reliability": _RELIABILITY[qos.reliability],
        "durability": _DURABILITY[qos.durability],
        "deadline": _UNLIMITED,
        "lifespan": _UNLIMITED,
        "liveliness": 1,  # automatic
        "liveliness_lease_duration": _UNLIMITED,
        "avoid_ros_namespace_conventions": False,
    }
    return str(yaml.dump([profile], sort_keys=False, Dumper=_PlainDumper))


class _PlainDumper(yaml.SafeDumper):
    """Writes equal values out instead of references to the first one."""

    def ignore_aliases(self, _: Any) -> bool:
        return True


def _channel_key(sample: Sample) -> tuple[str, bytes, str]:
    return sample.topic, sample.gid, sample.type_hash
