"""Samples of every message type, as CDR and as JSON, for the tests of the page's decoder."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from cairn.bus.codec import Codec
from cairn.bus.type_hash import definition
from cairn.schemas.definitions import PLACEHOLDER
from cairn.schemas.field_types import Scalar, mark_of
from cairn.schemas.interfaces import interface
from cairn.schemas.packed import Packed
from tests.schemas.arbitrary import EVERY_MESSAGE, samples
from tests.schemas.random_messages import RandomMessages, message_names

_LONG = ("int64", "uint64")


def write(file: Path, count: int) -> None:
    """Write a line per message type: name, definition and `count` samples."""
    codec = Codec()
    with file.open("w", encoding="utf-8") as out:
        for name, messages in _every_message(count):
            found = [
                {"bytes": bytes(codec.encode(one)).hex(), "value": _plain(one)} for one in messages
            ]
            line = {"name": name, "schema": definition(type(messages[0])), "samples": found}
            out.write(json.dumps(line, allow_nan=False) + "\n")


def _every_message(count: int) -> Iterator[tuple[str, list[Any]]]:
    for name in EVERY_MESSAGE:
        yield name, samples(name, count)
    for name in message_names():
        if name not in EVERY_MESSAGE:
            random = RandomMessages(zlib.crc32(name.encode()))
            made = [random.make(interface(name), ascii=n % 2 == 0) for n in range(count)]
            yield name, made


def _plain(value: Any) -> Any:
    """Return what JSON can hold: 64-bit integers and non-finite numbers become texts."""
    if hasattr(type(value), "__ros_type__"):
        names = [field.name for field in fields(value) if field.name != PLACEHOLDER]
        return {name: _field(value, name) for name in names}
    if isinstance(value, Packed | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, np.ndarray):
        if value.dtype.name in _LONG:
            return [str(one) for one in value.tolist()]
        return [_plain(one) for one in value.tolist()]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def _field(message: Any, name: str) -> Any:
    value = getattr(message, name)
    mark = mark_of(get_type_hints(type(message), include_extras=True)[name])
    is_long = isinstance(mark, Scalar) and mark.ros_type in _LONG
    return str(value) if is_long else _plain(value)
