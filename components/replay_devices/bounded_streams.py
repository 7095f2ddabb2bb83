"""Decompresses recordings with limits: a few bytes of a compressed file may stand for gigabytes."""

from __future__ import annotations

import bz2
import codecs
import lzma
import os
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader, RawIOBase
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

from cairn.components.replay_devices.recording import damaged_line
from cairn.errors import RecordingError
from cairn.limits.files import megabytes, open_regular, too_large
from cairn.system.files import explain_os_error

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

LINE_BYTES: Final = 1 << 20
"""Longest line of a text recording [bytes]."""

TEXT_BYTES: Final = 1_000_000_000
"""Largest text recording, decompressed [bytes]."""

_SMALL_BYTES: Final = 64_000_000
# Of text every number is parsed and kept: 16 MB of scans take 180 to 380 MB of memory.
_SMALL_TEXT_BYTES: Final = 16_000_000
_RATIO: Final = 20  # recordings of robots compress 3 to 12 times
_FEW_LINES: Final = 150_000  # odometry of 67 Hz over half an hour, with two numbers a line
_BYTES_OF_LINE: Final = 20  # least room of a line in a genuine compressed file


def most_unpacked(size: int, small: int = _SMALL_BYTES) -> int:
    """Return how many bytes may come out of a compressed file of `size` bytes, `small` of any."""
    return max(small, _RATIO * size)


def too_much_unpacked(path: Path, most: int, small: int = _SMALL_BYTES) -> RecordingError:
    """Return the error for a file that unpacks to more than `most` bytes."""
    return RecordingError(
        f"{path} unpacks to more than {megabytes(most)} MB, the limit for a file of its size "
        f"({megabytes(small)} MB, or {_RATIO} times the size). If it is genuine, decompress "
        "it, and replay the decompressed file."
    )


def unpack_file(path: Path, target: Path) -> None:
    """Decompress a file that rosbag2 compressed by zstd; raise `RecordingError` if too large."""
    with open_regular(path) as packed, target.open("wb") as written:
        most = most_unpacked(os.fstat(packed.fileno()).st_size)
        size = 0
        try:
            with zstd.open(packed, "rb") as stream:
                while piece := stream.read(1 << 20):
                    size += len(piece)
                    if size > most:
                        raise too_much_unpacked(path, most)
                    written.write(piece)
        except (EOFError, zstd.ZstdError) as error:
            raise ValueError(f"{path.name} cannot be decompressed ({error})") from error


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield each line of a text file with its number, from 1 on.

    The file may be compressed by gzip, bzip2 or xz, which is found out by its content. Raises
    `RecordingError` for a file that cannot be read, is cut off, is not text, or exceeds a limit;
    all limits are checked before the first line is returned.
    """
    with _explained(path) as at:
        for _ in _raw_lines(path, at):
            pass
    yield from first_lines(path)


def first_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield lines as `text_lines` does, without reading the whole file before."""
    with _explained(path) as at:
        for raw in _raw_lines(path, at):
            if at.line == 1:
                raw = raw.removeprefix(codecs.BOM_UTF8)  # of editors of Windows
            yield at.line, raw.decode("ascii")


@dataclass
class _Position:
    """The number of the line that was read last."""

    line: int = 0


@contextmanager
def _explained(path: Path) -> Iterator[_Position]:
    """Turn errors of reading and decompressing into `RecordingError`."""
    at = _Position()
    try:
        yield at
    except (EOFError, zlib.error, lzma.LZMAError) as error:
        fault = f"the compressed stream is broken ({error})"
        raise damaged_line(path, at.line + 1, fault) from error
    except UnicodeDecodeError as error:
        raise damaged_line(path, at.line, "not a text file") from error
    except MemoryError as error:  # an xz stream states how much memory it needs
        raise damaged_line(path, at.line + 1, "its decompression needs too much memory") from error
    except OSError as error:
        if error.errno is None:  # raised by bz2 for a damaged stream
            fault = f"the bzip2 stream is broken ({error})"
            raise damaged_line(path, at.line + 1, fault) from error
        raise RecordingError(f"{path} cannot be read: {explain_os_error(error)}.") from error


def _raw_lines(path: Path, at: _Position) -> Iterator[bytes]:
    with open_regular(path) as packed:
        size = os.fstat(packed.fileno()).st_size
        stream = _unpacking(packed)
        most = (
            TEXT_BYTES
            if stream is packed
            else min(TEXT_BYTES, most_unpacked(size, _SMALL_TEXT_BYTES))
        )
        most_lines = max(_FEW_LINES, size // _BYTES_OF_LINE)
        if stream is packed and size > most:
            raise too_large(path, size, most)
        total = 0
        while raw := stream.readline(LINE_BYTES + 1):
            at.line += 1
            total += len(raw)
            if len(raw) > LINE_BYTES:
                fault = f"it is longer than {LINE_BYTES:,} bytes, which is the limit"
                raise damaged_line(path, at.line, fault)
            if total > most:
                raise too_much_unpacked(path, most, _SMALL_TEXT_BYTES)
            if at.line > most_lines:
                raise RecordingError(
                    f"{path} has more than {most_lines:,} lines, the limit for a file of its size. "
                    "If it is genuine, decompress it, and replay the decompressed file."
                )
            yield raw


_GZIP: Final = b"\x1f\x8b"
_PIECE: Final = 1 << 16  # read of a compressed file at a time [bytes]


class _GzipStream(RawIOBase):
    """Decompresses the members of a gzip file (RFC 1952); what follows them is ignored.

    Some servers and mail programs append a line; gunzip ignores it as well, `gzip` of Python does
    not.
    """

    def __init__(self, packed: BinaryIO) -> None:
        self._packed, self._read = packed, b""
        self._member = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        room = memoryview(buffer).cast("B")
        while True:
            if self._member.eof:
                self._read = self._member.unused_data
                self._read += self._packed.read(max(0, len(_GZIP) - len(self._read)))
                if not self._read.startswith(_GZIP):
                    return 0
                self._member = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
            self._read = self._read or self._packed.read(_PIECE)
            piece = self._member.decompress(self._read, len(room))
            if not piece and not self._read and not self._member.eof:
                raise EOFError("it ended before the end of the stream")
            self._read = self._member.unconsumed_tail
            if piece:
                room[: len(piece)] = piece
                return len(piece)


def _unpacking(packed: BinaryIO) -> BinaryIO:
    """Return the stream that decompresses a file, or the file itself if it is not compressed."""
    magic = packed.read(6)
    packed.seek(0)
    # Their own iterators are written in Python, and slow.
    if magic.startswith(_GZIP):
        return BufferedReader(_GzipStream(packed))
    if magic.startswith(b"BZh"):
        return BufferedReader(bz2.open(packed, "rb"))
    if magic.startswith(b"\xfd7zXZ\0"):
        return BufferedReader(lzma.open(packed, "rb"))
    return packed
