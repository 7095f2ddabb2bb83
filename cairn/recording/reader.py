"""Reads a recording, of one or several MCAP files, in order of time and at any time."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from decimal import Decimal
from itertools import count
from pathlib import Path
from typing import Final, NamedTuple

from cairn.errors import RecordingError
from cairn.limits.files import megabytes
from cairn.recording.mcap_file import (
    ALL_CHANNELS,
    Block,
    McapFile,
    Progress,
    RecordedAttachment,
    RecordedChannel,
    RecordedMessage,
)
from cairn.system.clock import SECOND
from cairn.system.closing import Closing

MOST_FILES: Final = 10_000
"""Files of a recording."""

_PENDING_BYTES: Final = 256_000_000
_LAST_BYTES: Final = 256_000_000  # of the last messages of all topics
_MESSAGE_COST: Final = 300  # what a message takes in memory beside its data [bytes]
_UNIX_FROM_S: Final = 100_000_000  # more than three years of recording


class _FileBlock(NamedTuple):
    """A block of a file, with the file's number."""

    start_ns: int
    file: int
    at: int
    block: Block


class McapRecording(Closing):
    """A recording: one MCAP file, or the files into which a recorder split it.

    Use it in a `with` statement, in one thread. Only what is asked for is read from the disk.

    Attributes:
        files: its files, in order of time.
        counts: the number of messages of each channel.
        start_ns, end_ns: time of arrival of the first and the last message; 0 without messages.
        attachments: the attached files; of equal names the last one is the newest.
        metadata: its metadata records, by name.
        size: bytes on the disk.
    """

    def __init__(self, paths: Path | Sequence[Path], progress: Progress | None = None) -> None:
        """Open a file, a folder's `*.mcap` files, or several of these.

        A file that was not closed, because its recorder was killed, is read once as a whole;
        `progress` is called meanwhile. Raises `RecordingError` if a file is not an MCAP file.
        """
        self._stack = ExitStack()
        self._notes: list[str] = []
        with ExitStack() as stack:
            files = []
            for path in _files(paths):
                file = stack.enter_context(McapFile(path))
                files.append((file, file.index(progress)))
            self._stack = stack.pop_all()
        files.sort(key=lambda one: min((b.start_ns for b in one[1]), default=0))
        self._files = [file for file, _ in files]
        self.files = [file.path for file in self._files]
        self.size = sum(file.size for file in self._files)
        self._parts = sorted(
            _FileBlock(block.start_ns, number, block.at, block)
            for number, (_, blocks) in enumerate(files)
            for block in blocks
        )
        self.start_ns = self._parts[0].start_ns if self._parts else 0
        self.end_ns = max((part.block.end_ns for part in self._parts), default=0)
        # The latest time of all blocks up to each one, in order of their starts.
        self._latest: list[int] = []
        for part in self._parts:
            self._latest.append(max(part.block.end_ns, self._latest[-1] if self._latest else 0))
        self.counts: Counter[RecordedChannel] = Counter()
        self.attachments: list[RecordedAttachment] = []
        self.metadata: dict[str, dict[str, str]] = {}
        for file in self._files:
            self.counts.update(file.counts)
            self.attachments += file.attachments
            self.metadata |= file.metadata

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    @property
    def channels(self) -> list[RecordedChannel]:
        """Its channels, in order of topic and publisher."""
        return sorted(self.counts, key=lambda one: (one.topic, one.node, one.gid, one.type))

    @property
    def notes(self) -> list[str]:
        """What could not be read, as sentences that begin with the file; reading may add some."""
        return [f"{file.path}: {text}" for file in self._files for text in file.notes]

    def read_attachment(self, attachment: RecordedAttachment) -> bytes:
        """Return the content of an attachment; raise `RecordingError` if it is damaged."""
        (file,) = (file for file in self._files if file.path == attachment.path)
        return file.read_attachment(attachment)

    def time_ns(self, time_s: Decimal | float) -> int:
        """Return a time as users give it, in seconds after the start or since 1970, in ns."""
        given_ns = round(time_s * SECOND)
        return given_ns if time_s >= _UNIX_FROM_S else self.start_ns + given_ns

    def find_attachment(self, name: str) -> bytes | None:
        """Return the content of the newest attachment of a name; None if there is none."""
        found = [one for one in self.attachments if one.name == name]
        return self.read_attachment(found[-1]) if found else None

    def messages(
        self,
        start_ns: int = 0,
        end_ns: int = 2**64,
        channels: Collection[RecordedChannel] | None = None,
        progress: Progress | None = None,
    ) -> Iterator[RecordedMessage]:
        """Yield the messages from `start_ns` to `end_ns` in the order of their arrival.

        Those that arrived in the same nanosecond are in the order of the file. A latched message
        that the recorder repeated at the start of a file comes once. `channels` are all by default.

        Raises `RecordingError` if the file is not nearly in order of time, so that more than 256 MB
        would have to be kept in memory.
        """
        bits = self._bits(channels)
        parts = [
            part
            for part in self._parts
            if part.start_ns <= end_ns
            and part.block.end_ns >= start_ns
            and part.block.channels & bits[part.file]
        ]
        pending: list[tuple[int, int, int, int, RecordedMessage]] = []
        kept = 0
        repeats = RepeatedMessages()
        done, total = 0, sum(part.block.end - part.at for part in parts)
        for number, part in enumerate(parts):
            position = count()
            for one in self._files[part.file].load(part.block, bits[part.file], start_ns, end_ns):
                heapq.heappush(pending, (one.log_ns, part.file, part.at, next(position), one))
                kept += _MESSAGE_COST + len(one.data)
                if kept > _PENDING_BYTES:
                    raise RecordingError(
                        f"{self._files[part.file].path}: more than {megabytes(_PENDING_BYTES)} MB "
                        f"at byte {part.at:,} belong to one time; sort it with `mcap sort`"
                    )
            before = parts[number + 1].start_ns if number + 1 < len(parts) else 2**64
            while pending and pending[0][0] < before:
                message = heapq.heappop(pending)[-1]
                kept -= _MESSAGE_COST + len(message.data)
                if not repeats.contains(message):
                    yield message
            if progress is not None:
                done += part.block.end - part.at
                progress(done, total)

    def latched_at(
        self, time_ns: int, channels: Collection[RecordedChannel] | None = None
    ) -> list[RecordedMessage]:
        """Return what a subscriber gets that starts at a time: the last message of latched topics.

        As `last_at`; `channels` are all by default.
        """
        chosen = self.counts if channels is None else channels
        return self.last_at(time_ns, [one for one in chosen if one.latched])

    def last_at(self, time_ns: int, channels: Collection[RecordedChannel]) -> list[RecordedMessage]:
        """Return the last messages of channels up to a time.

        They are in the order of their arrival, one of each publisher. Of a publisher that started
        again, only the messages of the last process are among them.
        """
        found: dict[RecordedChannel, RecordedMessage] = {}
        kept = 0
        missing = {one for one in channels if self.counts[one]}
        bits = self._bits(missing)
        newest_found = -1  # of those that are missing, because an earlier block may end later
        for number in range(len(self._parts) - 1, -1, -1):
            part = self._parts[number]
            if part.start_ns > time_ns:
                continue
            if newest_found >= self._latest[number]:
                latest = self._latest[number]
                missing -= {one for one, message in found.items() if message.log_ns >= latest}
                if not missing:
                    break
                bits = self._bits(missing)
                newest_found = max(
                    (found[one].log_ns for one in missing & found.keys()), default=-1
                )
            if not part.block.channels & bits[part.file]:
                continue
            for message in self._files[part.file].load(part.block, bits[part.file], 0, time_ns):
                known = found.get(message.channel)
                if known is None or known.log_ns <= message.log_ns:
                    kept += len(message.data) - (0 if known is None else len(known.data))
                    if kept > _LAST_BYTES:
                        raise RecordingError(
                            f"{self._files[part.file].path}: the last messages of its topics have "
                            f"more than {megabytes(_LAST_BYTES)} MB; choose fewer topics"
                        )
                    found[message.channel] = message
                    newest_found = max(newest_found, message.log_ns)
        newest: dict[tuple[str, str], RecordedMessage] = {}
        for message in sorted(found.values(), key=lambda one: one.log_ns):
            newest[message.channel.topic, message.channel.node or message.channel.gid] = message
        return sorted(newest.values(), key=lambda one: one.log_ns)

    def _bits(self, channels: Collection[RecordedChannel] | None) -> list[int]:
        if channels is None:
            return [ALL_CHANNELS] * len(self._files)
        return [file.bits(channels) for file in self._files]


class RepeatedMessages:
    """Finds latched messages that a recorder repeated at the start of a file."""

    def __init__(self) -> None:
        self._last: dict[RecordedChannel, tuple[int, int]] = {}

    def contains(self, message: RecordedMessage) -> bool:
        """Return whether a message is not newer than the last one of its publisher; note it."""
        channel = message.channel
        if not (channel.latched and channel.gid):
            return False
        number = (message.publish_ns, message.sequence)
        if number <= self._last.get(channel, (-1, -1)):
            return True
        self._last[channel] = number
        return False


def mcap_files(folder: Path) -> list[Path]:
    """Return the files of a recording in the order in which its recorder numbered them."""
    return sorted(folder.glob("*.mcap"), key=lambda file: (len(file.name), file.name))


def _files(paths: Path | Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for path in [paths] if isinstance(paths, Path) else paths:
        if path.is_dir():
            if not (found := mcap_files(path)):
                raise RecordingError(f"{path}: holds no *.mcap file; give a recording")
            files += found
        else:
            files.append(path)
    if not 1 <= len(files) <= MOST_FILES:
        raise RecordingError(f"{len(files):,} files are given; give 1 to {MOST_FILES:,}")
    return files
