"""Checksums of rows: SQLite notices damage of its own structure, not of what is in it."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Any


def checksum(values: Iterable[Any]) -> int:
    """What a row of numbers, texts and bytes is known again by (CRC-32)."""
    total = 0
    for value in values:
        total = zlib.crc32(_bytes(value), zlib.crc32(b"|", total))
    return total


def check(values: Iterable[Any], stored: Any) -> None:
    """Raise `ValueError` if a row is not as it was written.

    `stored` is its checksum then; of rows that older programs wrote it is None.
    """
    if stored is not None and stored != checksum(values):
        raise ValueError("it is not as it was written: its checksum differs")


def _bytes(value: Any) -> bytes:
    if isinstance(value, bytes):
        return value
    if isinstance(value, int | float):
        # SQLite gives whole numbers back as the column's type has them, and no minus before 0.
        value = float(value) + 0.0
    return repr(value).encode()
