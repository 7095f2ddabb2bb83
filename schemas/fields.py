"""Reads a message class's fields and constants: what its ROS 2 definition follows from."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar, get_args, get_origin, get_type_hints

from cairn.schemas.message import type_name
from cairn.schemas.packed import Packed
from cairn.schemas.primitives import Array, Scalar, Text, mark_of


@dataclass(frozen=True)
class Field:
    """A field: the type of an element, and how many of it.

    `element` is the name of a ROS 2 primitive or a message class; `count` is None for a single
    one, 0 for a sequence, else the length of the array. `packed`: the field is a `Packed`.
    """

    name: str
    element: str | type[Any]
    count: int | None = None
    packed: bool = False


@dataclass(frozen=True)
class Constant:
    """A constant of a message type."""

    name: str
    ros_type: str
    value: bool | int | float | str


_known: dict[type[Any], tuple[Field, ...]] = {}


def fields_of(message: type[Any]) -> tuple[Field, ...]:
    """The fields of a message class in the order on the wire.

    Raises `TypeError` if the class is not a message, or a field is of no type that messages have.
    """
    if message not in _known:
        type_name(message)
        hints = get_type_hints(message, include_extras=True)
        _known[message] = tuple(
            _field(message, field.name, hints[field.name]) for field in fields(message)
        )
    return _known[message]


def constants_of(message: type[Any]) -> tuple[Constant, ...]:
    """The constants of a message class: its `ClassVar` primitives."""
    type_name(message)
    found: list[Constant] = []
    for name, hint in get_type_hints(message, include_extras=True).items():
        if get_origin(hint) is ClassVar:
            mark = mark_of(get_args(hint)[0])
            if isinstance(mark, Scalar | Text):
                found.append(Constant(name, _ros_type(mark), getattr(message, name)))
    return tuple(found)


def _field(message: type[Any], name: str, hint: Any) -> Field:
    mark = mark_of(hint)
    if isinstance(mark, Array):
        return Field(name, mark.ros_type, mark.length or 0)
    if mark is not None:
        return Field(name, _ros_type(mark))
    arguments = get_args(hint)
    if get_origin(hint) is Packed:
        return Field(name, arguments[0], 0, packed=True)
    if get_origin(hint) is tuple and arguments[1:] == (...,):
        element = _field(message, name, arguments[0])
        if element.count is None:
            return Field(name, element.element, 0)
    if isinstance(hint, type) and "__ros_type__" in hint.__dict__:
        return Field(name, hint)
    raise TypeError(
        f"{message.__qualname__}.{name}: {hint} is no type of a message's field; use a primitive "
        "of cairn.schemas.primitives, a message, a tuple of them (..., ...) or Packed"
    )


def _ros_type(mark: Scalar | Text) -> str:
    return mark.ros_type if isinstance(mark, Scalar) else "string"
