"""Lines of a recording's text file, plain or compressed, with their numbers."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from cairn.components.replay.recording import RecordingError


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Each line with its number from 1 on; plain, gzip and bzip2 are told apart by content.

    Raises `RecordingError` for a file that cannot be read, is cut off or is no text.
    """
    line = 0
    try:
        with _opened(path) as stream:
            for line, raw in enumerate(stream, start=1):
                yield line, raw.decode("ascii")
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise damaged(path, line + 1, f"the gzip stream is broken ({error})") from error
    except UnicodeDecodeError as error:
        raise damaged(path, line, "not a text file") from error
    except OSError as error:
        if error.errno is None:  # what bz2 raises for a damaged stream
            raise damaged(path, line + 1, f"the bzip2 stream is broken ({error})") from error
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error


def damaged(path: Path, line: int, what: str) -> RecordingError:
    """The error for a line that cannot be right."""
    return RecordingError(
        f"{path}, line {line}: {what}. The file is cut off, changed or of another format: "
        "take a fresh copy of the data set."
    )


def _opened(path: Path) -> gzip.GzipFile | bz2.BZ2File | BufferedReader:
    with path.open("rb") as stream:
        magic = stream.read(3)
    if magic[:2] == b"\x1f\x8b":
        return gzip.open(path, "rb")
    if magic == b"BZh":
        return bz2.open(path, "rb")
    return path.open("rb")
