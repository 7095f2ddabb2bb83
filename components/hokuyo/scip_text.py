"""SCIP's characters: check sums, and numbers in printable text.

Hokuyo, *Communication Protocol Specification For SCIP2.0* (C-42-03320B), "Data encoding" and
"Check sum".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
"""Characters of data in a full line; a check sum and a line feed come after them."""

_ZERO = 0x30
_BASE = 64


class ScipError(ValueError):
    """Text that is not what SCIP allows: damaged on its way, or of another protocol."""


def check_sum(text: bytes) -> bytes:
    """The character that is sent after `text`: the sum's lowest six bits, printable."""
    return bytes([(sum(text) & 0x3F) + _ZERO])


def with_sum(text: bytes) -> bytes:
    """A line's text with its check sum."""
    return text + check_sum(text)


def checked(line: bytes) -> bytes:
    """A line's text, its check sum verified and taken off; raises `ScipError`."""
    text = line[:-1]
    if not text or check_sum(text) != line[-1:]:
        raise ScipError(f"the check sum of {_shown(line)} is wrong")
    return text


def encode_number(value: int, width: int) -> bytes:
    """A number in `width` characters of six bits, the highest first; `ScipError` if too large."""
    if not 0 <= value < _BASE**width:
        raise ScipError(f"{value} does not go into {width} characters")
    return bytes(_ZERO + (value >> 6 * place) % _BASE for place in reversed(range(width)))


def decode_number(text: bytes) -> int:
    """The number that these characters stand for; raises `ScipError` for other characters."""
    value = 0
    for character in text:
        if not _ZERO <= character < _ZERO + _BASE:
            raise ScipError(f"{_shown(text)} is not a number")
        value = value * _BASE + character - _ZERO
    return value


def encode_numbers(values: NDArray[np.integer], width: int) -> bytes:
    """Numbers of `width` characters each, one after the other; `ScipError` if one is too large."""
    if values.size and not 0 <= values.min() <= values.max() < _BASE**width:
        raise ScipError(f"there are values that do not go into {width} characters")
    places = 6 * np.arange(width - 1, -1, -1)
    digits = (values.astype(np.int64)[:, None] >> places) % _BASE
    return (digits + _ZERO).astype(np.uint8).tobytes()


def decode_numbers(text: NDArray[np.uint8], width: int) -> NDArray[np.int32]:
    """The numbers that characters stand for, `width` of them (at most 5) each.

    Raises `ScipError` if a character stands for nothing, or the last number is not whole.
    """
    digits = text - np.uint8(_ZERO)  # what is below "0" becomes large
    if text.size % width or (text.size and int(digits.max()) >= _BASE):
        raise ScipError(f"{text.size} characters are not numbers of {width} characters")
    weights = _BASE ** np.arange(width - 1, -1, -1, dtype=np.int32)
    return digits.reshape(-1, width).astype(np.int32) @ weights


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("ascii", "replace"))
