"""What makes a class a message: its ROS 2 name, validation, immutability and equality."""

import dataclasses
import re
import struct
from collections.abc import Callable
from math import isfinite
from operator import attrgetter
from typing import Any, NoReturn, TypeVar, cast, dataclass_transform, get_type_hints

import numpy as np
from pydantic import ConfigDict, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic_core import ArgsKwargs

from cairn.schemas.primitives import Scalar, Text, mark_of

T = TypeVar("T")

_NAME = re.compile("[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_CONFIG = ConfigDict(extra="forbid", validate_default=True)
_LONGEST_VALUE = 60


class InvalidMessage(ValueError):  # noqa: N818 - says what the message is
    """A message breaks its definition: which type, where in it, what stands there, why not."""

    def __init__(self, type_name: str, path: str, value: object, reason: str) -> None:
        self.type_name = type_name
        self.path = path
        self.value = _shortened(value)
        self.reason = reason
        where = " = ".join(part for part in (path, self.value) if part)
        super().__init__(f"{type_name}: {where}: {reason}")

    def within(self, type_name: str, field: str) -> "InvalidMessage":
        """The same, told of the message of type `type_name` that holds this one in `field`."""
        path = ".".join(part for part in (field, self.path) if part)
        return InvalidMessage(type_name, path, _Shortened(self.value), self.reason)


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def message(name: str) -> Callable[[type[T]], type[T]]:
    """Make a class the definition of the ROS 2 message type `name` ("geometry_msgs/msg/Point").

    The annotated fields, in this order, are the fields on the wire: primitives of
    `cairn.schemas.primitives`, other messages, `tuple[Message, ...]`, `tuple[String, ...]` or
    `cairn.schemas.packed.Packed`. `ClassVar` primitives with a value are the type's constants.
    Instances are frozen, and equal if all fields are, NaN being equal to NaN. In place of a
    message that another one holds, its constructor also takes a mapping of fields.

    A message cannot be made invalid: the constructor raises `InvalidMessage`. What must hold
    between fields is checked by the class's `__post_init__`, which calls `refuse`.
    """
    if not _NAME.fullmatch(name):
        raise TypeError(f"{name!r} is not a ROS 2 message name such as geometry_msgs/msg/Point")

    def decorate(cls: type[T]) -> type[T]:
        check = cls.__dict__.get("__post_init__")
        _round_float32(cls)
        made = pydantic_dataclass(frozen=True, eq=False, config=_CONFIG)(cls)
        names = tuple(field.name for field in dataclasses.fields(made))
        if not names:
            raise TypeError(f"{name}: a message has at least one field")
        for attribute, value in (
            ("__init__", _constructor(name, names, *_plain_fields(made, check))),
            ("__eq__", _equality(names)),
            ("__hash__", _hashing(name, names)),
            ("__ros_type__", name),
            ("__check__", check),
        ):
            setattr(made, attribute, value)
        return cast("type[T]", made)

    return decorate


def type_name(cls: type[Any]) -> str:
    """The ROS 2 name of a message class: "geometry_msgs/msg/Twist".

    Raises `TypeError` if the class is not a message.
    """
    name = cls.__dict__.get("__ros_type__")
    if not isinstance(name, str):
        raise TypeError(f"{cls.__qualname__} is not a message: it is not decorated with @message")
    return name


def own_check(cls: type[Any]) -> Callable[[Any], None] | None:
    """What a message class checks between its fields: its own `__post_init__`, if it has one."""
    return cast("Callable[[Any], None] | None", cls.__dict__["__check__"])


def refuse(message: object, path: str, value: object, reason: str) -> NoReturn:
    """Raise `InvalidMessage` for a message under construction."""
    raise InvalidMessage(type_name(type(message)), path, value, reason)


def _constructor(
    name: str, fields: tuple[str, ...], plain: dict[str, type[Any]], defaults: dict[str, Any]
) -> Callable[..., None]:
    def __init__(self: Any, /, *args: Any, **kwargs: Any) -> None:  # noqa: N807
        # Most messages are points, headers and what is made of these: valid at a glance.
        if defaults and not args:
            for field, value in kwargs.items():
                kind = plain.get(field)
                if type(value) is not kind:
                    break
                if kind is float and not isfinite(value):
                    break
                if kind is str and not (value.isascii() and value.isprintable()):
                    break
            else:
                self.__dict__.update(defaults)
                self.__dict__.update(kwargs)
                return
        try:
            self.__pydantic_validator__.validate_python(
                ArgsKwargs(args, kwargs), self_instance=self
            )
            return
        except ValidationError as error:
            invalid = _translated(name, fields, error)
        # Out here, and always a new error: a ValidationError that its own cause refers to is never
        # freed, because Python cannot see the cycle through pydantic-core.
        raise invalid

    return __init__


def _plain_fields(
    cls: type[Any], check: Callable[[Any], None] | None
) -> tuple[dict[str, type[Any]], dict[str, Any]]:
    """The fields of which any finite float, plain text or message of a type is valid; all defaults.

    Nothing if the message has other fields, too, or something to check between them.
    """
    plain: dict[str, type[Any]] = {}
    for field, hint in get_type_hints(cls, include_extras=True).items():
        mark = mark_of(hint)
        if mark in (Scalar("float64"), Scalar("float64", finite=True)):
            plain[field] = float
        elif mark == Text():
            plain[field] = str
        elif isinstance(hint, type) and "__ros_type__" in hint.__dict__:
            plain[field] = hint
    defaults = {field.name: field.default for field in dataclasses.fields(cls)}
    if check or any(type(default) is not plain.get(field) for field, default in defaults.items()):
        return {}, {}
    return plain, defaults


def _translated(name: str, fields: tuple[str, ...], error: ValidationError) -> InvalidMessage:
    first = error.errors(include_url=False)[0]
    path = ""
    for index, place in enumerate(first["loc"]):
        if isinstance(place, str):
            path += f".{place}" if path else place
        elif index == 0 and place < len(fields):
            path = fields[place]
        else:
            path += f"[{place}]"
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InvalidMessage):
        return cause.within(name, path)
    if first["type"] == "missing":
        return InvalidMessage(name, path, _Shortened(), "is required")
    reason = str(cause) if cause else first["msg"][0].lower() + first["msg"][1:]
    return InvalidMessage(name, path, first["input"], reason)


class _Shortened(str):
    """The text of a value that is short enough."""

    __slots__ = ()


def _shortened(value: object) -> str:
    if isinstance(value, _Shortened):
        return str(value)
    if isinstance(value, np.ndarray):
        with np.printoptions(threshold=8, edgeitems=3):
            text = f"{value.dtype}[{value.size}] {value}".replace("\n", "")
    elif isinstance(value, str | bytes | list | tuple) and len(value) > _LONGEST_VALUE:
        text = f"{value[:_LONGEST_VALUE]!r}... ({len(value)} long)"
    else:
        text = repr(value)
    return text if len(text) <= 2 * _LONGEST_VALUE else f"{text[: 2 * _LONGEST_VALUE]}..."


def _round_float32(cls: type[Any]) -> None:
    # A float32 field holds what the wire can carry, so that a message is the same before and
    # after a journey. All fields of a class at once, because it is on the path of each decoding.
    names = [
        name
        for name, annotation in get_type_hints(cls, include_extras=True).items()
        if isinstance(mark := mark_of(annotation), Scalar) and mark.ros_type == "float32"
    ]
    if not names:
        return
    own = cls.__dict__.get("__post_init__")
    single = struct.Struct(f"<{len(names)}f")
    first, *others = names
    get = attrgetter(*names) if others else lambda self: (getattr(self, first),)

    def __post_init__(self: Any) -> None:  # noqa: N807
        given = get(self)
        try:
            rounded = single.unpack(single.pack(*given))
        except OverflowError:
            for name, value in zip(names, given, strict=True):
                try:
                    struct.pack("<f", value)
                except OverflowError:
                    refuse(self, name, value, "is too large for a float32")
            raise
        if rounded != given:
            self.__dict__.update(zip(names, rounded, strict=True))
        if own is not None:
            own(self)

    cls.__post_init__ = __post_init__


def _equality(fields: tuple[str, ...]) -> Callable[[Any, object], bool]:
    def __eq__(self: Any, other: object) -> bool:  # noqa: N807
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(getattr(self, field), getattr(other, field)) for field in fields)

    return __eq__


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    return bool(one == other) or (one != one and other != other)


def _hashing(name: str, fields: tuple[str, ...]) -> Callable[[Any], int]:
    # Arrays count by their length alone and NaN as nothing, so that equals have equal hashes.
    def part(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.size
        return value if value == value else None

    def __hash__(self: Any) -> int:  # noqa: N807
        return hash((name, *(part(getattr(self, field)) for field in fields)))

    return __hash__
