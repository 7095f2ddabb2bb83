"""When the images of a folder were taken."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from cairn import SECOND
from cairn.components.replay.recording import RecordingError
from cairn.components.replay.text_lines import text_lines

TIMES = "times.txt"
"""The file that tells it: a line for each image, its time [s], and its name if need be."""

# Images without times of their own begin here, as a robot's clock is never at 0 [ns].
_FIRST = SECOND
# Whole numbers of so many digits are times since 1970 in milli-, micro-, nanoseconds.
_UNITS = {13: SECOND // 1000, 16: SECOND // 1_000_000, 19: 1}
_SECONDS = re.compile(r"[0-9]{10}\.[0-9]+")


def at_rate(count: int, rate_hz: float) -> list[int]:
    """Times [ns] of so many images taken at a steady rate."""
    return [_FIRST + round(index * SECOND / rate_hz) for index in range(count)]


def times_of(folder: Path, files: Sequence[Path], rate_hz: float | None) -> list[int]:
    """The times [ns] of a folder's images: by `times.txt`, their names, or `rate_hz`.

    Raises `RecordingError` if none of them tells, or a table without names is not in order.
    """
    table = folder / TIMES
    if table.is_file():
        stamps = _by_table(table, files)
    elif all(_of_name(file) is not None for file in files):
        stamps = [_of_name(file) or 0 for file in files]
    elif rate_hz is not None:
        return at_rate(len(files), rate_hz)
    else:
        raise RecordingError(
            f"{folder}: nothing tells when its images were taken: give image_rate_hz, or a file "
            f"{TIMES} with a time [s] for each image, line by line; names such as {files[0].name} "
            "are no times since 1970"
        )
    return stamps


def check_order(folder: Path, files: Sequence[Path], stamps: Sequence[int]) -> None:
    """Raise `RecordingError` unless each of the files was taken after the one before it."""
    for (before, earlier), (file, later) in pairwise(zip(files, stamps, strict=True)):
        if later <= earlier:
            raise RecordingError(
                f"{folder}: {file.name} was taken at {later / SECOND:.6f} s, not after "
                f"{before.name}, at {earlier / SECOND:.6f} s: put right their names or {TIMES}"
            )


def _by_table(table: Path, files: Sequence[Path]) -> list[int]:
    rows = []
    for number, text in text_lines(table):
        words = text.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        rows.append((_stamp(table, number, words[0]), words[1:]))
    if rows and all(rest for _, rest in rows):
        named = {Path(rest[0]).name: stamp for stamp, rest in rows}
        missing = [file.name for file in files if file.name not in named]
        if missing:
            raise RecordingError(
                f"{table} has no time for {missing[0]} ({len(missing)} of {len(files)} images "
                "lack one): add it, or take the images away"
            )
        return [named[file.name] for file in files]
    if len(rows) != len(files):
        raise RecordingError(
            f"{table} has {len(rows)} times, but there are {len(files)} images: give each a line, "
            "or put the image's name behind the time"
        )
    stamps = [stamp for stamp, _ in rows]
    check_order(table.parent, files, stamps)
    return stamps


def _stamp(table: Path, number: int, word: str) -> int:
    if word.isdecimal() and len(word) in _UNITS:
        return int(word) * _UNITS[len(word)]
    try:
        seconds = float(word)
    except ValueError:
        seconds = math.nan
    if not 0 <= seconds < 1e11:
        raise RecordingError(f"{table}, line {number}: {word} is no time in seconds")
    return round(seconds * 1e6) * 1000


def _of_name(file: Path) -> int | None:
    """The time since 1970 [ns] that a file's name holds; None if it holds none."""
    seconds = _SECONDS.search(file.stem)
    if seconds is not None:
        whole, _, part = seconds[0].partition(".")
        return int(whole) * SECOND + int(part[:9].ljust(9, "0"))
    for digits in re.findall(r"[0-9]+", file.stem):
        if len(digits) in _UNITS:
            return int(digits) * _UNITS[len(digits)]
    return None
