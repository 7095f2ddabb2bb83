"""Read JSON from other processes with limits on its size, depth and numbers."""

import codecs
from math import isfinite
from typing import Any, Final

from pydantic_core import from_json

_DEPTH: Final = 100
_INTEGERS: Final = 2**64  # lowest and highest number of 64 bits, signed or not


def parse_json(data: bytes, longest: int) -> Any:
    """Return the value of a JSON text of at most `longest` bytes.

    Numbers must be finite, integers have at most 64 bits. Raises `ValueError`, and no other error.
    """
    if len(data) > longest:
        raise too_large(len(data), longest)
    if data[: len(codecs.BOM_UTF8)] == codecs.BOM_UTF8:  # of editors of Windows
        data = data[len(codecs.BOM_UTF8) :]
    value = from_json(data, allow_inf_nan=False, cache_strings=False)
    _check(value, _DEPTH)
    return value


def too_large(size: int, longest: int) -> ValueError:
    """Return the error about a text of `size` bytes."""
    return ValueError(f"it has {size:,} bytes, more than the {longest:,} that are allowed")


def _check(value: Any, depth: int) -> None:
    if depth == 0:
        raise ValueError(f"it is nested deeper than {_DEPTH} levels")
    if isinstance(value, dict):
        for part in value.values():
            _check(part, depth - 1)
    elif isinstance(value, list):
        for part in value:
            _check(part, depth - 1)
    elif isinstance(value, float) and not isfinite(value):
        raise ValueError("it has a number that is too large for 64 bits")
    elif isinstance(value, int) and not -_INTEGERS < value < _INTEGERS:
        raise ValueError("it has an integer of more than 64 bits")
