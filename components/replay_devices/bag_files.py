"""Reads the messages of ROS 1 bags, MCAP files and ROS 2 bags in sequence, with limits.

Indices, counts, message definitions and QoS in a bag are not used: nothing depends on whether they
are true. All lengths are checked against the file, and all decompression is bounded. rosbags, which
reads by these indices, has no limits.

Formats: wiki.ros.org/Bags/Format/2.0, and 1.2 of the year 2009; mcap.dev/spec; SQLite tables and
metadata.yaml of rosbag2_storage.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import BinaryIO, Final

from cairn.components.replay_devices.bounded_streams import (
    most_unpacked,
    too_much_unpacked,
    unpack_file,
)
from cairn.errors import RecordingError
from cairn.limits.compression import RECORD_BYTES, is_zstd, unpack, unpack_message
from cairn.limits.files import open_regular
from cairn.limits.sqlite import SchemaError, bound_connection, table_columns
from cairn.limits.yaml import read_yaml
from cairn.recording.mcap_file import McapFile, RecordedChannel
from cairn.recording.mcap_records import MAGIC
from cairn.recording.reader import RepeatedMessages, mcap_files

_DEFINITION_1_2, _MESSAGE, _HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(1, 8)
_LONGEST_HEADER: Final = 1 << 16
_CHUNK_HEADER: Final = 128  # longest header of a chunk, among them where an undamaged one starts
_MOST_TOPICS: Final = 10_000
MOST_DAMAGES: Final = 1_000
"""Damages of a bag that is read nevertheless."""

_MOST_FILES: Final = 10_000
_PACKED: Final = ".zstd"
_UINT32 = struct.Struct("<I")
_TIME = struct.Struct("<II")


class NotSupported(ValueError):
    """A bag is whole, and in a form that is not read."""


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag; `type` as `package/msg/Name`, `md5` of its definition in ROS 1, else "".

    `is_ros1`: its messages are in the format of ROS 1.
    """

    name: str
    type: str
    md5: str = ""
    is_ros1: bool = False


Wanted = Callable[[BagTopic], bool]
Message = tuple[BagTopic, int, bytes]
"""Topic, time of receipt [ns] and serialized bytes."""


@dataclass
class BagFile:
    """A bag at `path`, a file or the folder of a ROS 2 bag; a generator's end completes the rest.

    `counts` has the number of messages of each topic, `lost` says what is damaged of a ROS 1 bag or
    an MCAP file.
    """

    path: Path
    counts: Counter[BagTopic] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    is_ros1: bool = False
    size: int = 0
    """Bytes that the bag takes on the disk."""
    _unpacked: int = 0
    _repeats: RepeatedMessages = field(default_factory=RepeatedMessages)

    def messages(self, wanted: Wanted) -> Iterator[Message]:
        """Yield the messages of the wanted topics in the order of the file.

        A damaged ROS 1 bag or MCAP file is read past its damages. Raises `RecordingError` for a bag
        that exceeds a limit, `ValueError`, `OSError`, `sqlite3.Error`, `yaml.YAMLError` for others.
        """
        self.counts.clear()
        self.lost.clear()
        self.size = self._unpacked = 0
        self._repeats = RepeatedMessages()
        if (self.path / "metadata.yaml").is_file():
            yield from self._folder(wanted)
        elif self.path.is_dir():
            for file in [*mcap_files(self.path), *sqlite_files(self.path)]:
                yield from self._file(file, wanted)
        else:
            yield from self._file(self.path, wanted)

    def unpacked(self, size: int) -> None:
        """Count bytes that were decompressed; raise `RecordingError` if they are too many."""
        self._unpacked += size
        most = most_unpacked(self.size)
        if self._unpacked > most:
            raise too_much_unpacked(self.path, most)

    def plain(self, message: bytes) -> bytes:
        """Return a message, decompressed if it is compressed by itself."""
        if is_zstd(message):
            message = unpack_message(message)
            self.unpacked(len(message))
        return message

    def add_topic(self, topic: BagTopic) -> BagTopic:
        """Count a topic without messages."""
        self.counts[topic] += 0
        if len(self.counts) > _MOST_TOPICS:
            raise ValueError(f"it has more than {_MOST_TOPICS:,} topics")
        return topic

    def damage(self, text: str) -> None:
        """Note a damage of a ROS 1 bag; raise `RecordingError` if there are too many."""
        self.lost.append(text)
        if len(self.lost) > MOST_DAMAGES:
            raise RecordingError(
                f"{self.path} has more than {MOST_DAMAGES:,} damages, the last: {text}. Repair it "
                "with `rosbag reindex`, or take a fresh copy."
            )

    def _file(self, path: Path, wanted: Wanted) -> Iterator[Message]:
        with open_regular(path) as stream:
            self.size += os.fstat(stream.fileno()).st_size
            magic = stream.read(16)
            data = _FileBytes(stream)
            if magic.startswith(b"#ROS"):
                self.is_ros1 = True
                yield from _Ros1(self, wanted).records(data, magic.find(b"\n") + 1, "")
            elif magic.startswith(MAGIC):
                yield from self._mcap(path, wanted)
            elif magic == b"SQLite format 3\0":
                with _with_log(path) as database:
                    yield from _sqlite_messages(self, database, wanted)
            else:
                raise ValueError(f"{path.name} starts with {magic!r}, like no kind of bag")

    def _mcap(self, path: Path, wanted: Wanted) -> Iterator[Message]:
        topics: dict[RecordedChannel, BagTopic] = {}

        def topic_of(channel: RecordedChannel) -> BagTopic:
            if channel not in topics:
                kind, encoding = ros2_type(channel.type), channel.encoding
                if encoding not in ("cdr", "ros1"):
                    kind = f"{kind} in {encoding[:20]}"  # which is not read
                topics[channel] = self.add_topic(
                    BagTopic(channel.topic, kind, is_ros1=encoding == "ros1")
                )
            return topics[channel]

        with McapFile(path) as file:
            try:
                for one in file.messages(lambda channel: wanted(topic_of(channel))):
                    if not self._repeats.contains(one):
                        yield topic_of(one.channel), one.log_ns, self.plain(one.data)
            finally:
                for channel, count in file.counts.items():
                    self.counts[topic_of(channel)] += count
                for note in file.notes:
                    self.damage(note)

    def _folder(self, wanted: Wanted) -> Iterator[Message]:
        described = read_yaml(self.path / "metadata.yaml")
        try:
            info = described["rosbag2_bagfile_information"]
            names = [PurePath(name).name for name in info["relative_file_paths"]]
            mode = str(info.get("compression_mode") or "none").lower()
            compression = str(info.get("compression_format") or "zstd")
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"metadata.yaml does not describe a bag: {error!r}") from error
        if not 1 <= len(names) <= _MOST_FILES:
            raise ValueError(f"metadata.yaml lists {len(names):,} files, not 1 to {_MOST_FILES:,}")
        if mode not in ("none", "file", "message") or compression != "zstd":
            raise NotSupported(f"its compression is {compression[:20]!r} ({mode[:20]!r})")
        for part in self._parts(names):
            with self._decompressed(part) as file:
                yield from self._file(file, wanted)

    def _parts(self, names: list[str]) -> list[Path]:
        """Return the files of a bag that are there, of those that metadata.yaml names.

        Others of a bag that was renamed; with or without the ending of a packed file. Raises
        `ValueError` if there is none.
        """
        found, missing = [], []
        for name in names:
            plain = name.removesuffix(_PACKED)
            same = [self.path / one for one in (name, plain, plain + _PACKED)]
            there = next((file for file in same if file.is_file()), None)
            found += [there] if there is not None else []
            missing += [name] if there is None else []
        if missing and not found:
            found = [*mcap_files(self.path), *sqlite_files(self.path)]
        if not found:
            raise ValueError(f"the file {missing[0]} that metadata.yaml names is missing")
        for name in missing:
            self.damage(f"the file {name} that metadata.yaml names is missing")
        return found

    @contextmanager
    def _decompressed(self, file: Path) -> Iterator[Path]:
        if file.suffix != _PACKED:
            yield file
            return
        with TemporaryDirectory() as folder:
            unpack_file(file, Path(folder, "bag"))
            yield Path(folder, "bag")


class _FileBytes:
    """The bytes of a file, of which only those that a slice selects are in memory."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._size = os.fstat(stream.fileno()).st_size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        start, end, _ = part.indices(self._size)
        self._stream.seek(start)
        return self._stream.read(max(end - start, 0))


Data = bytes | _FileBytes


# --- ROS 1 --------------------------------------------------------------------------------------

# A record is a header (length, then fields `name=value`, each with its length) and data (length,
# then bytes); in format 2.0 messages are in chunks of records.


@dataclass
class _Ros1:
    bag: BagFile
    wanted: Wanted
    topics: dict[bytes, BagTopic] = field(default_factory=dict)

    def records(self, data: Data, at: int, location: str) -> Iterator[Message]:
        while at < len(data):
            record = _record(data, at)
            if record is None:
                resumed = _next_chunk(data, at + 1) if not location else None
                end = len(data) if resumed is None else resumed
                last = None if location or resumed is not None else _cut_off_chunk(data, at)
                if last is not None:
                    self.bag.damage(f"the chunk at byte {at} is cut off")
                    rest = self._unpacked(last, data, at, cut_off=True)
                    yield from self.records(rest, 0, f" of the chunk at byte {at}")
                else:
                    self.bag.damage(f"{end - at} bytes from byte {at}{location} on are damaged")
                if resumed is None:
                    return
                at = resumed
                continue
            kind = record.fields["op"][0]
            if kind == _CHUNK:
                if location:
                    self.bag.damage(f"a chunk is in another chunk, at byte {at}{location}")
                else:
                    inner = f" of the chunk at byte {at}"
                    yield from self.records(self._unpacked(record, data, at), 0, inner)
            elif kind in (_CONNECTION, _DEFINITION_1_2):
                self._connect(record.fields, data[record.begin : record.end])
            elif kind == _MESSAGE:
                message = self._message(record.fields)
                if message is None:
                    self.bag.damage(f"the message at byte {at}{location} belongs to no topic")
                else:
                    topic, received = message
                    self.bag.counts[topic] += 1
                    if self.wanted(topic):
                        yield topic, received, data[record.begin : record.end]
            at = record.end

    def _unpacked(self, record: _BagRecord, data: Data, at: int, *, cut_off: bool = False) -> bytes:
        declared = record.fields.get("size", b"")
        compression = _text(record.fields.get("compression", b""))
        try:
            size = _UINT32.unpack(declared)[0]
            packed = data[record.begin : record.end]
            unpacked = unpack(packed, compression, size, cut_off=cut_off)
        except (ValueError, struct.error) as error:
            self.bag.damage(f"the chunk at byte {at}: {error}")
            return b""
        self.bag.unpacked(len(unpacked))
        return unpacked

    def _connect(self, header: dict[str, bytes], body: bytes) -> None:
        described = header if "def" in header else (_fields(body) or {})
        if described.get("type"):
            topic = header.get("topic", b"")
            md5 = described.get("md5sum", described.get("md5", b""))
            self.topics[header.get("conn", topic)] = self.bag.add_topic(
                BagTopic(_text(topic), ros2_type(_text(described["type"])), _text(md5), True)
            )

    def _message(self, header: dict[str, bytes]) -> tuple[BagTopic, int] | None:
        topic = self.topics.get(header.get("conn", header.get("topic", b"")))
        if "time" in header and len(header["time"]) == _TIME.size:
            seconds, nanoseconds = _TIME.unpack(header["time"])
        elif len(header.get("sec", b"")) == len(header.get("nsec", b"")) == _UINT32.size:
            seconds, nanoseconds = _TIME.unpack(header["sec"] + header["nsec"])
        else:
            return None
        return None if topic is None else (topic, seconds * 1_000_000_000 + nanoseconds)


@dataclass(frozen=True, slots=True)
class _BagRecord:
    """The fields of a record's header, and where its data begin and end."""

    fields: dict[str, bytes]
    begin: int
    end: int


def _record(data: Data, at: int, longest: int = _LONGEST_HEADER) -> _BagRecord | None:
    """Return the record at byte `at`, None if there is none."""
    header_end = _sized_end(data, at, longest)
    if header_end is None:
        return None
    fields = _fields(data[at + 4 : header_end])
    if not fields or len(fields.get("op", b"")) != 1:
        return None
    if fields["op"][0] not in range(_DEFINITION_1_2, _CONNECTION + 1):
        return None
    end = _sized_end(data, header_end, RECORD_BYTES)
    if end is None or not _whole_index(fields, end - header_end - 4):
        return None
    return _BagRecord(fields, header_end + 4, end)


def _cut_off_chunk(data: Data, at: int) -> _BagRecord | None:
    """Return the chunk at byte `at` of which a file has only the beginning; None without one."""
    header_end = _sized_end(data, at, _CHUNK_HEADER)
    fields = None if header_end is None else _fields(data[at + 4 : header_end])
    if header_end is None or not fields or fields.get("op") != bytes([_CHUNK]):
        return None
    return _BagRecord(fields, min(header_end + 4, len(data)), len(data))


def _whole_index(header: dict[str, bytes], length: int) -> bool:
    """Return whether an index is as long as its entries; else what follows would be skipped."""
    if header["op"][0] != _INDEX or header.get("ver") != _UINT32.pack(1):
        return True
    return header.get("count") == _UINT32.pack(length // 12) and length % 12 == 0


def _sized_end(data: Data, at: int, longest: int) -> int | None:
    """Return where the bytes end that follow their length at byte `at`."""
    length = data[at : at + 4]
    if len(length) < 4:
        return None
    size = int(_UINT32.unpack(length)[0])
    end = at + 4 + size
    return None if end > len(data) or size > longest else end


def _fields(head: bytes) -> dict[str, bytes] | None:
    fields: dict[str, bytes] = {}
    at = 0
    while at < len(head):
        end = _sized_end(head, at, len(head))
        if end is None:
            return None
        name, equal, value = head[at + 4 : end].partition(b"=")
        if not equal:
            return None
        fields[_text(name)] = value
        at = end
    return fields


def _next_chunk(data: Data, at: int) -> int | None:
    """Return where the next whole chunk starts, at most the length of a chunk after byte `at`."""
    block = 1 << 20
    tries = 0
    for begin in range(at, min(len(data), at + RECORD_BYTES), block):
        piece = data[begin : begin + block + 3]
        found = piece.find(b"op=\x05")
        while found >= 0:
            # Its fields `compression` and `size` are before or after `op`, in any order.
            for start in range(begin + found - 8, max(at, begin + found - 64) - 1, -1):
                record = _record(data, start, _CHUNK_HEADER)
                if record is not None and "compression" in record.fields:
                    return start
            tries += 1
            if tries > MOST_DAMAGES:
                return None
            found = piece.find(b"op=\x05", found + 1)
    return None


def ros2_type(name: str) -> str:
    """Return the name of a type as ROS 2 writes it; ROS 1, and some programs, write p/Name."""
    return name.replace("/", "/msg/", 1) if "/msg/" not in name else name


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", errors="replace")


# --- SQLite -------------------------------------------------------------------------------------

_TABLES: Final = {"schema", "metadata", "topics", "message_definitions", "messages"}
_INDICES: Final = {"timestamp_idx"}
_COLUMNS: Final = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"id", "topic_id", "timestamp", "data"},
}
_LONGEST_NAME: Final = 1_000


def sqlite_files(folder: Path) -> list[Path]:
    """Return the databases of a ROS 2 bag in the order in which its recorder numbered them."""
    files = [*folder.glob("*.db3"), *folder.glob(f"*.db3{_PACKED}")]
    return sorted(files, key=lambda file: (len(file.name), file.name))


@contextmanager
def _with_log(path: Path) -> Iterator[Path]:
    """Yield a database; a copy with the log beside it, which a killed recorder has left."""
    log = path.with_name(f"{path.name}-wal")
    if not log.is_file() or not log.stat().st_size:
        yield path
        return
    with TemporaryDirectory() as folder:
        for file in (path, log):
            shutil.copyfile(file, Path(folder, file.name))
        copy = Path(folder, path.name)
        with closing(sqlite3.connect(copy)) as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        yield copy


def _sqlite_messages(bag: BagFile, path: Path, wanted: Wanted) -> Iterator[Message]:
    # If its reader fails, a generator is closed by the garbage collector, on any thread.
    file = f"{path.resolve().as_uri()}?immutable=1"
    with closing(sqlite3.connect(file, uri=True, check_same_thread=False)) as connection:
        bound_connection(connection, longest=RECORD_BYTES, steps=max(20_000_000, 2 * bag.size))
        columns = table_columns(connection, _TABLES, _INDICES)
        for table, names in _COLUMNS.items():
            if not names <= columns.get(table, {}).keys():
                raise SchemaError(f"its table {table} is missing, or is not that of a ROS 2 bag")
        rows = connection.execute(
            "SELECT id, name, type, serialization_format FROM topics WHERE length(name) <= ? "
            f"AND length(type) <= ? LIMIT {_MOST_TOPICS + 1}",
            (_LONGEST_NAME, _LONGEST_NAME),
        ).fetchall()
        topics = {}
        for number, name, kind, encoding in rows:
            of = str(kind) if encoding == "cdr" else f"{kind} in {str(encoding)[:20]}"
            topics[number] = bag.add_topic(BagTopic(str(name), of))
        for number, count in connection.execute(
            "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
        ):
            if number in topics:
                bag.counts[topics[number]] += int(count)
        numbers = [number for number, topic in topics.items() if wanted(topic)]
        places = ", ".join("?" * len(numbers))
        for number, received, raw in connection.execute(
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places}) "
            "ORDER BY rowid",
            numbers,
        ):
            if not isinstance(received, int) or not isinstance(raw, bytes):
                raise ValueError(f"a message of {topics[number].name} is not a message: {received}")
            yield topics[number], received, bag.plain(raw)
