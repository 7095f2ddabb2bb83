"""Messages: the `@message` decorator, and the validation of messages constructed or decoded.

A message is validated by its class's constructor or, when it comes from the bus, by the function
that `decoding_constructor` returns: no handler receives an invalid message. The type hash (RIHS01)
and the ROS 2 definition of a message are computed in `cairn.bus.type_hash`.
"""

import dataclasses
import importlib
import pkgutil
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from math import isfinite
from operator import attrgetter
from typing import (
    Annotated,
    Any,
    ClassVar,
    Generic,
    NoReturn,
    TypeVar,
    cast,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from pydantic import ConfigDict, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic_core import ArgsKwargs

from cairn.schemas.field_types import (
    Array,
    Scalar,
    Text,
    array_validator,
    mark_of,
    several_of,
)
from cairn.schemas.packed import Packed

T = TypeVar("T")


_NAME = re.compile("[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9_]*")


_CONFIG = ConfigDict(extra="forbid", validate_default=True)


_LONGEST_VALUE = 60


Request = TypeVar("Request")
Response = TypeVar("Response")
Goal = TypeVar("Goal")
Result = TypeVar("Result")
Feedback = TypeVar("Feedback")


class Service(Generic[Request, Response]):
    """Base class of all ROS 2 services, which have the message classes of their two sides.

    A service is a type, of which there are no instances. `Event` is the message by which tools
    observe calls (REP 2012).
    """

    Request: type[Any]
    Response: type[Any]
    Event: type[Any]


class Action(Generic[Goal, Result, Feedback]):
    """Base class of all ROS 2 actions, which have the message classes of their three parts.

    An action is a type, of which there are no instances. Goals and results are sent by two
    services, feedback by a topic.
    """

    Goal: type[Any]
    Result: type[Any]
    Feedback: type[Any]
    SendGoal: type[Service[Any, Any]]
    GetResult: type[Service[Any, Any]]
    FeedbackMessage: type[Any]


class InvalidMessage(ValueError):
    """A message breaks its definition: names the type, the path in it, the value and the reason."""

    def __init__(self, type_name: str, path: str, value: object, reason: str) -> None:
        self.type_name = type_name
        self.path = path
        self.value = _shortened(value)
        self.reason = reason
        where = " = ".join(part for part in (path, self.value) if part)
        super().__init__(f"{type_name}: {where}: {reason}")

    def within(self, type_name: str, field: str) -> "InvalidMessage":
        """Return this error for the message of type `type_name` that holds this one in `field`."""
        path = ".".join(part for part in (field, self.path) if part)
        return InvalidMessage(type_name, path, _Shortened(self.value), self.reason)


Repair = Callable[[dict[str, Any]], list[str]]
"""Corrects the values of a message's fields in place; returns what was repaired, in words."""


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def message(
    name: str, *, repair: Repair | None = None, independent: tuple[str, ...] = ()
) -> Callable[[type[T]], type[T]]:
    """Decorate a class that defines the ROS 2 message type `name` ("geometry_msgs/msg/Point").

    The annotated fields, in this order, are the fields on the wire: primitives of
    `cairn.schemas.field_types`, other messages, `tuple[Message, ...]`, `tuple[String, ...]` (marked
    `Several` if their number is limited) or `cairn.schemas.packed.Packed`. `ClassVar` primitives
    with a value are the type's constants. Instances are immutable, and equal if all fields are, NaN
    being equal to NaN. For a field that is a message, the constructor also accepts a mapping of its
    fields.

    An invalid message cannot be constructed: the constructor raises `InvalidMessage`. Constraints
    between fields are checked by the class's `__post_init__`, which calls `reject`.

    Other programs are less strict: an invalid message that was received is corrected by `repair`,
    which knows which fields are redundant and which values mean "not known". Of the sequences named
    in `independent`, invalid elements are left out. See `received_message`.
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
            ("__repair__", repair),
            ("__independent__", independent),
        ):
            setattr(made, attribute, value)
        return cast("type[T]", made)

    return decorate


def reject(message: object, path: str, value: object, reason: str) -> NoReturn:
    """Raise `InvalidMessage` for a message under construction."""
    raise InvalidMessage(type_name(type(message)), path, value, reason)


def received_message(cls: type[T], values: Mapping[str, Any]) -> T:
    """Return a message of values that another program has sent, repaired if it is invalid.

    `repairs_of` returns what was repaired. Raises `InvalidMessage` if it is invalid nevertheless.
    """
    repair: Repair | None = cls.__dict__["__repair__"]
    try:
        return cls(**values)
    except InvalidMessage:
        if repair is None:
            raise
    corrected = dict(values)
    repairs = repair(corrected)
    made = cls(**corrected)
    set_repairs(made, repairs)
    return made


def repairs_of(message: Any) -> tuple[str, ...]:
    """Return what was repaired in a message that was received, a text for each; as a rule nothing.

    The texts have no values, so that those of one sender are equal from message to message.
    """
    repairs: tuple[str, ...] = message.__dict__.get(_REPAIRS, ())
    return repairs


def set_repairs(message: Any, repairs: Iterable[str]) -> None:
    """Note what was repaired in a message that is being made of what was received."""
    if noted := tuple(dict.fromkeys(repairs)):
        message.__dict__[_REPAIRS] = noted


_REPAIRS = "__repairs__"


def independent_elements(cls: type[Any]) -> tuple[str, ...]:
    """Return the sequences of a message class of which invalid elements are left out."""
    names: tuple[str, ...] = cls.__dict__["__independent__"]
    return names


def type_name(cls: type[Any]) -> str:
    """Return the ROS 2 name of a message class: "geometry_msgs/msg/Twist".

    Raises `TypeError` if the class is not a message.
    """
    name = cls.__dict__.get("__ros_type__")
    if not isinstance(name, str):
        raise TypeError(f"{cls.__qualname__} is not a message: it is not decorated with @message")
    return name


def schema_messages() -> dict[str, type[Any]]:
    """Return the message classes of `cairn.schemas` by type name; imports all its modules."""
    found: dict[str, type[Any]] = {}
    package = importlib.import_module("cairn.schemas")
    for module_info in pkgutil.iter_modules(package.__path__, "cairn.schemas."):
        module = importlib.import_module(module_info.name)
        for value in vars(module).values():
            if isinstance(value, type) and value.__module__ == module.__name__:
                try:
                    found[type_name(value)] = value
                except TypeError:
                    continue  # not a message
    return found


def classes_in(message: type[Any]) -> Iterator[type[Any]]:
    """Yield a message class and those of its fields, at any depth, each once."""
    waiting, seen = [message], set[type[Any]]()
    while waiting:
        one = waiting.pop()
        if one not in seen:
            seen.add(one)
            yield one
            parts = [field.element for field in fields_of(one)]
            waiting += [part for part in reversed(parts) if isinstance(part, type)]


@dataclass(frozen=True)
class Field:
    """A field of a message: the type of its elements, and their number.

    `element` is the name of a ROS 2 primitive or a message class; `count` is None for a single
    element, 0 for a sequence, else the length of the array. `packed`: the field is a `Packed`.
    `most` is the bound of a bounded sequence, `text_most` that of bounded strings [bytes].
    """

    name: str
    element: str | type[Any]
    count: int | None = None
    packed: bool = False
    most: int | None = None
    text_most: int | None = None


@dataclass(frozen=True)
class Constant:
    """A constant of a message type."""

    name: str
    ros_type: str
    value: bool | int | float | str


def fields_of(message: type[Any]) -> tuple[Field, ...]:
    """Return the fields of a message class in the order on the wire.

    Raises `TypeError` if the class is not a message, or a field has a type that messages lack.
    """
    if message not in _fields_cache:
        type_name(message)
        hints = get_type_hints(message, include_extras=True)
        _fields_cache[message] = tuple(
            _field(message, field.name, hints[field.name]) for field in fields(message)
        )
    return _fields_cache[message]


def composed_type(
    base: type[Any], name: str, parts: Mapping[str, type[Any]], attributes: Mapping[str, Any]
) -> type[Any]:
    """Return the class of a service or action, `base`, of which ROS 2 has a type hash.

    `parts` are the classes of its messages and services by their names in its ROS 2 description.
    """
    made = type(name.split("/")[2], (base,), {**attributes, "__ros_type__": name})
    _fields_cache[made] = tuple(Field(part, element) for part, element in parts.items())
    return made


def constants_of(message: type[Any]) -> tuple[Constant, ...]:
    """Return the constants of a message class: its `ClassVar` primitives."""
    type_name(message)
    constants: list[Constant] = []
    for name, hint in get_type_hints(message, include_extras=True).items():
        if get_origin(hint) is ClassVar:
            mark = mark_of(get_args(hint)[0])
            if isinstance(mark, Scalar | Text):
                constants.append(Constant(name, _ros_type(mark), getattr(message, name)))
    return tuple(constants)


def decoding_constructor(message: type[T]) -> Callable[..., T]:
    """Return a function that makes a message of its fields in order, as a CDR decoder reads them.

    Numbers and strings are Python's, numeric sequences are read-only arrays, other sequences
    lists. The function accepts and rejects the same messages as the class's constructor in half
    the time: it checks only what the definition demands beyond the types on the wire, and calls
    the constructor for values that are not obviously valid. It is generated, as dataclasses do,
    because a loop over the fields would be as slow as the constructor.
    """
    hints = get_type_hints(message, include_extras=True)
    names = [field.name for field in fields(message)]  # type: ignore[arg-type]
    # No field of a ROS 2 message begins with an underscore, but one may be named `tuple`.
    namespace: dict[str, Any] = {
        "_message": message, "_new": object.__new__, "_isfinite": isfinite, "_len": len,
        "_tuple": tuple,
    }  # fmt: skip
    conditions = [
        text for name in names if (text := _validity_condition(name, hints[name], namespace))
    ]
    texts = {name: mark for name in names if (mark := _text_sequence(hints[name])) is not None}
    parts = [
        f"{name}=_tuple({name})" if _is_tuple(hints[name]) else f"{name}={name}" for name in names
    ]
    arguments = ", ".join(names)
    lines = [f"def make({arguments}):"]
    for name, mark in texts.items():
        # Not by the constructor, which would make an error for each text.
        namespace[f"_reject_{name}"] = _text_rejection(type_name(message), name, mark)
        lines += [f"    for _text in {name}:"]
        lines += [f"        if not ({_text_condition('_text', mark)}):"]
        lines += [f"            _reject_{name}({name}, _text)"]
    if conditions:
        lines += [f"    if not ({' and '.join(conditions)}):"]
        lines += [f"        return _message({arguments})"]
    lines += ["    _made = _new(_message)", f"    _made.__dict__.update({', '.join(parts)})"]
    check = cross_field_check(message)
    if check is not None:
        namespace["_check"] = check
        lines += ["    _check(_made)"]
    lines += ["    return _made"]
    exec(
        compile("\n".join(lines), f"<decoding constructor of {message.__qualname__}>", "exec"),
        namespace,
    )
    return cast("Callable[..., T]", namespace["make"])


def cross_field_check(cls: type[Any]) -> Callable[[Any], None] | None:
    """Return the check between the fields of a message class: its own `__post_init__`, or None."""
    return cast("Callable[[Any], None] | None", cls.__dict__["__check__"])


def _constructor(
    name: str, fields: tuple[str, ...], plain: dict[str, type[Any]], defaults: dict[str, Any]
) -> Callable[..., None]:
    def __init__(self: Any, /, *args: Any, **kwargs: Any) -> None:
        # Fast path: most messages are points, headers and compositions of these.
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
        # Raised outside of `except`, and always a new error: a ValidationError that its own cause
        # refers to is never freed, because Python cannot see the cycle through pydantic-core.
        raise invalid

    return __init__


def _plain_fields(
    cls: type[Any], check: Callable[[Any], None] | None
) -> tuple[dict[str, type[Any]], dict[str, Any]]:
    """Return the types of fields of which any finite float, text or message is valid; all defaults.

    Both are empty if the message has other fields, too, or a check between fields.
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
    """The text of a value, shortened already."""

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
    # A float32 field holds what the wire can carry, so that a message is the same before and after
    # it was sent. All fields of a class at once, because every decoding does this.
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

    def __post_init__(self: Any) -> None:
        values = get(self)
        try:
            rounded = single.unpack(single.pack(*values))
        except OverflowError:
            for name, value in zip(names, values, strict=True):
                try:
                    struct.pack("<f", value)
                except OverflowError:
                    reject(self, name, value, "is too large for a float32")
            raise
        if rounded != values:
            self.__dict__.update(zip(names, rounded, strict=True))
        if own is not None:
            own(self)

    cls.__post_init__ = __post_init__


def _equality(fields: tuple[str, ...]) -> Callable[[Any, object], bool]:
    def __eq__(self: Any, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(getattr(self, field), getattr(other, field)) for field in fields)

    return __eq__


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    return bool(one == other) or (one != one and other != other)


def _hashing(name: str, fields: tuple[str, ...]) -> Callable[[Any], int]:
    # Arrays contribute their length only and NaN nothing, so that equal messages have equal hashes.
    def part(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.size
        return value if value == value else None

    def __hash__(self: Any) -> int:
        return hash((name, *(part(getattr(self, field)) for field in fields)))

    return __hash__


_fields_cache: dict[type[Any], tuple[Field, ...]] = {}


def _field(message: type[Any], name: str, hint: Any) -> Field:
    mark = mark_of(hint)
    if isinstance(mark, Array):
        return Field(name, mark.ros_type, mark.length or 0, most=mark.most)
    if isinstance(mark, Text):
        return Field(name, _ros_type(mark), text_most=mark.most)
    if mark is not None:
        return Field(name, _ros_type(mark))
    several = several_of(hint)
    hint = _without_marks(hint)
    arguments = get_args(hint)
    if get_origin(hint) is Packed:
        return Field(name, arguments[0], 0, packed=True)
    if get_origin(hint) is tuple and arguments[1:] == (...,):
        element = _field(message, name, arguments[0])
        if element.count is None:
            length, most = (several.length, several.most) if several else (None, None)
            return replace(element, count=length or 0, most=most)
    if isinstance(hint, type) and "__ros_type__" in hint.__dict__:
        return Field(name, hint)
    raise TypeError(
        f"{message.__qualname__}.{name}: {hint} is not a type of message fields; use a primitive "
        "of cairn.schemas.field_types, a message, a tuple of them (..., ...) or Packed"
    )


def _is_tuple(hint: Any) -> bool:
    return get_origin(_without_marks(hint)) is tuple


def _without_marks(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def _ros_type(mark: Scalar | Text) -> str:
    return mark.ros_type if isinstance(mark, Scalar) else "string"


def _validity_condition(name: str, hint: Any, namespace: dict[str, Any]) -> str:
    """Return the condition for an obviously valid field of the right type, as Python source."""
    match mark_of(hint):
        case Scalar() as mark:
            return _number_condition(name, mark)
        case Text() as mark:
            return _text_condition(name, mark)
        case Array() as mark:
            return _array_condition(name, mark, namespace)
    several = several_of(hint)
    if several is not None:
        return _count_condition(f"_len({name})", several.length, several.most)
    return ""  # a message, or several, which were validated when they were made; or texts


def _text_sequence(hint: Any) -> Text | None:
    """Return the mark of the texts if a field is a sequence of them."""
    element = mark_of(get_args(_without_marks(hint))[0]) if _is_tuple(hint) else None
    return element if isinstance(element, Text) else None


def _text_rejection(type_name: str, field: str, mark: Text) -> Callable[[Any, str], NoReturn]:
    """Return a function that raises `InvalidMessage` for one of the texts of a sequence."""

    def rejected(texts: Any, text: str) -> NoReturn:
        path = f"{field}[{list(texts).index(text)}]"
        raise InvalidMessage(type_name, path, text, f"must be {mark.requirement}")

    return rejected


def _number_condition(name: str, mark: Scalar) -> str:
    limits = [
        f"{name} {sign} {limit!r}"
        for sign, limit in ((">", mark.above), (">=", mark.at_least), ("<=", mark.at_most))
        if limit is not None
    ]
    if limits or mark.finite:
        limits.append(f"_isfinite({name})")
    return " and ".join(limits)


def _text_condition(name: str, mark: Text) -> str:
    if mark.one_of:
        return f"{name} in {mark.one_of!r}"
    bound = "" if mark.most is None else f" and _len({name}.encode()) <= {mark.most}"
    return f"'\\0' not in {name}{bound}"


def _count_condition(count: str, length: int | None, most: int | None) -> str:
    """Return the condition for a valid number of elements; an array's is right on the wire."""
    return f"{count} <= {most}" if most is not None and length is None else ""


def _array_condition(name: str, mark: Array, namespace: dict[str, Any]) -> str:
    if mark.ros_type == "bool":
        return "False"
    dtype = np.dtype("uint8" if mark.ros_type in ("byte", "char") else mark.ros_type)
    if mark.check is None:
        namespace[f"_dtype_{name}"] = dtype
        count = _count_condition(f"{name}.size", mark.length, mark.most)
        return " and ".join(filter(None, [f"{name}.dtype is _dtype_{name}", count]))
    validate = array_validator(dtype, mark.length, mark.check)

    def valid(array: Any) -> bool:
        try:
            return validate(array) is array
        except ValueError:
            return False

    namespace[f"_valid_{name}"] = valid
    return f"_valid_{name}({name})"
