"""Every type that the definitions in `schemas/` define, and random valid messages of each.

Messages of classes written by hand, which have rules between their fields, are those of
`tests.schemas.arbitrary`; the others are made here, by a seeded generator that is fast enough for
hundreds of types.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cairn.schemas.definitions import PLACEHOLDER
from cairn.schemas.message import Field, fields_of, type_name
from tests.schemas.arbitrary import EVERY_MESSAGE, samples

DATA = Path(__file__).parents[1] / "data" / "ros2"
HASHES: dict[str, str] = json.loads((DATA / "type_hashes.json").read_text())
"""The hash of every type by the official generator."""

_BY_HAND = frozenset(EVERY_MESSAGE.values())
_HAND_MADE_SAMPLES = 6
_DEEP = 3  # levels; below, sequences have at most one element
_ASCII = "aZ 09_/~\n\"'\\\x01"
_LETTERS = f"{_ASCII}äöüß€日本語😀"
_FLOATS = (0.0, -0.0, 1.5, -2.25, float("nan"), float("inf"), -float("inf"), 2.0**-149, 1e300)


@cache
def message_names() -> tuple[str, ...]:
    """Return the names of all messages, also those of services and actions."""
    return tuple(
        name
        for name in HASHES
        if f"{name}_Request" not in HASHES  # of a service
        and f"{name}_Goal" not in HASHES  # of an action
    )


class RandomMessages:
    """Makes random valid messages; the same ones for the same seed."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._letters = _LETTERS

    def make(self, cls: type[Any], *, ascii: bool = False) -> Any:  # noqa: A002
        """Return a message of a class; `ascii`: its texts have ASCII characters alone."""
        self._letters = _ASCII if ascii else _LETTERS
        return self._message(cls, 0)

    def _message(self, cls: type[Any], depth: int) -> Any:
        if cls in _BY_HAND:
            made = samples(type_name(cls), _HAND_MADE_SAMPLES)
            return made[0 if self._letters is _ASCII else self._below(len(made))]  # 0: no text
        return cls(**{field.name: self._field(field, depth) for field in fields_of(cls)})

    def _field(self, field: Field, depth: int) -> Any:
        if field.name == PLACEHOLDER:
            return 0
        if field.count is None:
            return self._one(field, depth)
        length = field.count or self._length(field, depth)
        if isinstance(field.element, type) or field.element == "string":
            return tuple(self._one(field, depth) for _ in range(length))
        dtype = "uint8" if field.element == "byte" else field.element
        return np.array([self._one(field, depth) for _ in range(length)], dtype)

    def _length(self, field: Field, depth: int) -> int:
        if depth >= _DEEP:
            return self._below(2)
        if field.most is not None and self._below(3) == 0:
            return field.most
        return self._below(min(4, (field.most or 3) + 1))

    def _one(self, field: Field, depth: int) -> Any:
        element = field.element
        if isinstance(element, type):
            return self._message(element, depth + 1)
        if element == "string":
            return self._text(field.text_most)
        if element == "bool":
            return self._below(2) == 1
        if element in ("float32", "float64"):
            number = float(self._random.normal(0, 1e3)) if self._below(2) else self._special()
            if element == "float32":
                with np.errstate(over="ignore"):
                    return float(np.float32(number))
            return number
        limits = np.iinfo("uint8" if element == "byte" else element)
        low, high = int(limits.min), int(limits.max)
        if self._below(2):
            return (low, high, 0, 1)[self._below(4)]
        return int(self._random.integers(low, high, dtype=limits.dtype, endpoint=True))

    def _special(self) -> float:
        return _FLOATS[self._below(len(_FLOATS))]

    def _text(self, most: int | None) -> str:
        if most is not None and self._below(3) == 0:
            return "x" * most
        length, letters = self._below(7), self._letters
        text = "".join(letters[self._below(len(letters))] for _ in range(length))
        while most is not None and len(text.encode()) > most:
            text = text[:-1]
        return text

    def _below(self, end: int) -> int:
        return int(self._random.integers(end))
