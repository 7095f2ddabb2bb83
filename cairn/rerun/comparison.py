"""Compares a published message with the recorded one: the first field that differs."""

from dataclasses import fields, is_dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from cairn.schemas.packed import Packed

_LONGEST: Final = 100


class FieldDifference(NamedTuple):
    """A field that differs: its path, the recorded value and that of the re-run, as texts."""

    path: str
    recorded: str
    rerun: str


def first_difference(recorded: Any, rerun: Any, path: str = "") -> FieldDifference | None:
    """Return the first field in which two messages of a class differ; None if they are equal."""
    if is_dataclass(recorded) and type(recorded) is type(rerun):
        for field in fields(recorded):
            inner = f"{path}.{field.name}" if path else field.name
            ours, theirs = getattr(recorded, field.name), getattr(rerun, field.name)
            difference = first_difference(ours, theirs, inner)
            if difference is not None:
                return difference
        return None
    if isinstance(recorded, Packed) and isinstance(rerun, Packed):
        return _of_sequences(recorded, rerun, recorded.array, rerun.array, path)
    if isinstance(recorded, np.ndarray) and isinstance(rerun, np.ndarray):
        return _of_sequences(recorded, rerun, recorded, rerun, path)
    if isinstance(recorded, list | tuple) and isinstance(rerun, list | tuple):
        for index, (ours, theirs) in enumerate(zip(recorded, rerun, strict=False)):
            difference = first_difference(ours, theirs, f"{path}[{index}]")
            if difference is not None:
                return difference
        return _of_lengths(len(recorded), len(rerun), path)
    if _bits(recorded) == _bits(rerun):
        return None
    return FieldDifference(path, _shown(recorded), _shown(rerun))


def _of_sequences(
    recorded: Any, rerun: Any, ours: Any, theirs: Any, path: str
) -> FieldDifference | None:
    """Compare sequences by the bits of their numbers, which are rows of two arrays."""
    count = min(len(ours), len(theirs))
    if count:
        one = np.ascontiguousarray(ours[:count]).reshape(count, -1).view(np.uint8)
        other = np.ascontiguousarray(theirs[:count]).reshape(count, -1).view(np.uint8)
        rows = np.flatnonzero((one != other).any(axis=1))
        if rows.size:
            index = int(rows[0])
            return first_difference(
                _plain(recorded[index]), _plain(rerun[index]), f"{path}[{index}]"
            ) or FieldDifference(f"{path}[{index}]", _shown(ours[index]), _shown(theirs[index]))
    return _of_lengths(len(ours), len(theirs), path)


def _of_lengths(recorded: int, rerun: int, path: str) -> FieldDifference | None:
    if recorded == rerun:
        return None
    return FieldDifference(path, f"{recorded} elements", f"{rerun} elements")


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _bits(value: Any) -> object:
    """Return what is equal for values with the same bits: NaN equals NaN, -0.0 differs from 0.0."""
    return np.float64(value).tobytes() if isinstance(value, float) else value


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
