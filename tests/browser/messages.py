"""Samples of every message class, as CDR and as JSON, for the tests of the page's decoder."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from cairn.bus.codec import Codec
from cairn.bus.type_hash import definition
from cairn.schemas.field_types import Scalar, mark_of
from cairn.schemas.packed import Packed
from tests.schemas.arbitrary import EVERY_MESSAGE, samples

_LONG = ("int64", "uint64")


def write(file: Path, count: int) -> None:
    """Write a line per message class: name, definition and `count` samples."""
    codec = Codec()
    with file.open("w", encoding="utf-8") as out:
        for name, cls in sorted(EVERY_MESSAGE.items()):
            found = [
                {"bytes": bytes(codec.encode(one)).hex(), "value": _plain(one)}
                for one in samples(name, count)
            ]
            line = {"name": name, "schema": definition(cls), "samples": found}
            out.write(json.dumps(line, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    """Return what JSON can hold: 64-bit integers and non-finite numbers become texts."""
    if hasattr(type(value), "__ros_type__"):
        return {field.name: _field(value, field.name) for field in fields(value)}
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
