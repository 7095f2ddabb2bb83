"""Packed: long sequences of messages that consist of numbers, stored as one array."""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any, Generic, TypeVar, get_args, get_type_hints, overload

import numpy as np
import numpy.typing as npt
from pydantic_core import CoreSchema, core_schema

from cairn.schemas.field_types import Scalar, mark_of

M = TypeVar("M")

_NUMBER = Scalar("float64", finite=True)


class Packed(Sequence[M], Generic[M]):
    """An immutable sequence of messages of which all fields are finite float64 numbers.

    `array` is read-only, of shape (length, columns): one row per message, columns in the order of
    the fields (for `Pose`: x, y, z of the position, x, y, z, w of the orientation). An element
    becomes a message object only when it is accessed. On the wire it is an ordinary sequence.
    """

    __slots__ = ("array", "element")

    def __init__(
        self, element: type[M], items: "npt.NDArray[Any] | Sequence[M] | Packed[M]" = ()
    ) -> None:
        """Store the rows of an array, without a copy if it is read-only, or message objects.

        Raises `ValueError` if the shape is not (n, columns), a number is not finite or an item
        is not of class `element`; `TypeError` if that class holds anything but finite float64.
        """
        columns = _columns(element)
        array = items if isinstance(items, np.ndarray) else _rows(element, items)
        if array.ndim != 2 or array.shape[1] != columns:
            raise ValueError(f"must have the shape (n, {columns}), not {array.shape}")
        if array.dtype != np.float64 or array.flags.writeable or not array.flags.c_contiguous:
            if array.dtype.kind not in "iuf":
                raise ValueError(f"must hold numbers, not {array.dtype}")
            array = np.array(array, np.float64, order="C")
            array.flags.writeable = False
        if not np.isfinite(array).all():
            raise ValueError("must hold finite numbers only")
        self.element = element
        self.array: npt.NDArray[np.float64] = array

    def __len__(self) -> int:
        return len(self.array)

    @overload
    def __getitem__(self, index: int) -> M: ...
    @overload
    def __getitem__(self, index: slice) -> "Packed[M]": ...
    def __getitem__(self, index: int | slice) -> "M | Packed[M]":
        if isinstance(index, slice):
            return Packed(self.element, self.array[index])
        return _made(self.element, iter(self.array[index].tolist()))

    def __iter__(self) -> Iterator[M]:
        return (_made(self.element, iter(row)) for row in self.array.tolist())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Packed):
            return NotImplemented
        return self.element is other.element and np.array_equal(self.array, other.array)

    def __hash__(self) -> int:
        return hash((self.element, len(self)))

    def __repr__(self) -> str:
        return f"Packed({self.element.__name__}, {self.array!r})"

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> CoreSchema:
        """Return how pydantic validates a field annotated `Packed[Message]`."""
        (element,) = get_args(source)
        _columns(element)

        def validate(value: object) -> Packed[Any]:
            if type(value) is Packed and value.element is element:
                return value
            if isinstance(value, np.ndarray | list | tuple):
                return Packed(element, value)
            raise ValueError(f"must be a sequence of {element.__name__}")

        return core_schema.no_info_plain_validator_function(validate)


_Parts = tuple[type[Any] | None, ...]
_known_parts: dict[type[Any], _Parts] = {}


def _parts(element: type[Any]) -> _Parts:
    # For each field None if it is a number, else the class of the message.
    parts = _known_parts.get(element)
    if parts is None:
        made_by_message = isinstance(element, type) and "__ros_type__" in element.__dict__
        if not made_by_message or hasattr(element, "__post_init__"):
            raise TypeError(f"{element} is not a message of finite float64 numbers alone")
        hints = get_type_hints(element, include_extras=True)
        parts = _known_parts[element] = tuple(
            None if mark_of(hints[field.name]) == _NUMBER else hints[field.name]
            for field in fields(element)
        )
    return parts


def _columns(element: type[Any]) -> int:
    return sum(1 if inner is None else _columns(inner) for inner in _parts(element))


def _rows(element: type[Any], items: Sequence[Any]) -> npt.NDArray[np.float64]:
    for item in items:
        if type(item) is not element:
            raise ValueError(f"must hold {element.__name__} objects only, not {item!r}")
    rows = [list(_numbers(element, item)) for item in items]
    return np.array(rows, np.float64).reshape(len(rows), _columns(element))


def _numbers(element: type[Any], item: Any) -> Iterator[float]:
    for field, inner in zip(fields(element), _parts(element), strict=True):
        value = getattr(item, field.name)
        if inner is None:
            yield value
        else:
            yield from _numbers(inner, value)


def _made(element: type[M], numbers: Iterator[float]) -> M:
    return element(
        *[next(numbers) if inner is None else _made(inner, numbers) for inner in _parts(element)]
    )
