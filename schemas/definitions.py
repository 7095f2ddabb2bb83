"""Interface definitions of ROS 2: reads `.msg`, `.srv` and `.action` files.

The syntax is that of https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html. Not
supported is `wstring`: no message of the common packages has one.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from keyword import iskeyword
from pathlib import Path
from typing import Any, Final

from cairn.errors import CairnError
from cairn.limits.files import read_bounded
from cairn.schemas.field_types import INTEGER_LIMITS

KINDS: Final = ("msg", "srv", "action")
"""The kinds of interfaces: the folders of a package, the endings of files, the middle of a name."""

PLACEHOLDER: Final = "structure_needs_at_least_one_member"
"""The one field, a uint8, that a definition without fields has on the wire."""

_LONGEST_NAME: Final = 200
"""Longest name of an interface; its file has a name of at most 255 bytes."""

_LONGEST_FILE: Final = 1 << 20
_LONGEST_REASON: Final = 300
_MOST_FIELDS: Final = 1000
_MOST_ITEMS: Final = 1_000_000
"""Most elements of an array; more would be a slip of the keyboard."""

_MOST_UNROLLED: Final = 1000
"""Most elements of an array of messages or strings: the codec has code for each element."""

_PRIMITIVES = frozenset({"bool", "float32", "float64", "string", *INTEGER_LIMITS})
_AS_PYTHON = re.compile("\\b(true|false)\\b")

_PACKAGE = "[a-z][a-z0-9_]*"
_ELEMENT = re.compile(
    rf"(?P<name>({_PACKAGE}/)?(msg/)?[A-Za-z][A-Za-z0-9]*)(<=(?P<text_most>[0-9]{{1,9}}))?"
    r"(?P<several>\[(?P<bounded><=)?(?P<count>[0-9]{0,9})\])?",
    re.ASCII,
)
_FIELD_NAME = re.compile("[a-z][a-z0-9]*(_[a-z0-9]+)*", re.ASCII)
_CONSTANT_NAME = re.compile("[A-Z][A-Z0-9]*(_[A-Z0-9]+)*", re.ASCII)
_INTERFACE = re.compile(
    f"({_PACKAGE})/(?:({'|'.join(KINDS)})/)?([A-Z][A-Za-z0-9]*(?:_[A-Z][A-Za-z]*)*)", re.ASCII
)


class DefinitionError(CairnError):
    """An interface definition is missing or invalid: names the file, the line and the reason."""


class UnsupportedDefinition(DefinitionError):
    """An interface definition is valid in ROS 2, and Cairn does not support it."""


class _Unsupported(ValueError):
    """Why a line is not supported."""


@dataclass(frozen=True)
class FieldDefinition:
    """A field as its file defines it.

    `element` is a primitive ("float64") or the full name of a message type; `count` is None for a
    single element, 0 for a sequence, else the length of an array. `most` bounds a sequence,
    `text_most` strings [bytes]. `default` is None if the file gives none. `line` is that in the
    file, 0 if the field belongs to a type that ROS 2 adds.
    """

    name: str
    element: str
    count: int | None = None
    most: int | None = None
    text_most: int | None = None
    default: Any = None
    line: int = field(default=0, compare=False)


@dataclass(frozen=True)
class ConstantDefinition:
    """A constant of a message type."""

    name: str
    element: str
    value: bool | int | float | str


@dataclass(frozen=True)
class MessageDefinition:
    """The fields and constants of one message type, which has a full name."""

    name: str
    fields: tuple[FieldDefinition, ...]
    constants: tuple[ConstantDefinition, ...] = ()


def full_type_name(name: str) -> str:
    """Return the full name of an interface: `std_msgs/String` is `std_msgs/msg/String`.

    Raises `DefinitionError` if it is not the name of an interface.
    """
    match = _INTERFACE.fullmatch(name)
    if match is None or len(name) > _LONGEST_NAME:
        raise DefinitionError(
            f"{name[:200]!r} is not the name of a ROS 2 interface such as std_msgs/msg/String, "
            "std_srvs/srv/Trigger or nav2_msgs/action/Spin"
        )
    package, kind, last = match.groups()
    return f"{package}/{kind or 'msg'}/{last}"


def read_definitions(path: Path, name: str) -> dict[str, MessageDefinition]:
    """Return the message types that a file defines, by full name.

    `name` is that of the interface. A `.msg` file defines a message of that name, a `.srv` file
    `<name>_Request` and `_Response`, an `.action` file `_Goal`, `_Result` and `_Feedback`, and the
    types of the services and topics by which ROS 2 implements an action. Raises `DefinitionError`.
    """
    try:
        text = read_bounded(path, _LONGEST_FILE).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise DefinitionError(f"{path}: cannot be read: {error}") from error
    return parse_definitions(text, name, str(path))


def parse_definitions(text: str, name: str, source: str) -> dict[str, MessageDefinition]:
    """Return the message types that the text of a file defines; see `read_definitions`.

    Errors name `source`.
    """
    kind = name.split("/")[1]
    parts = {
        "msg": ("",),
        "srv": ("_Request", "_Response"),
        "action": ("_Goal", "_Result", "_Feedback"),
    }[kind]
    sections: list[list[tuple[int, str]]] = [[]]
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if content == "---":
            sections.append([])
        elif content:
            sections[-1].append((number, content))
    if len(sections) != len(parts):
        raise DefinitionError(
            f"{source}: has {len(sections)} parts, separated by ---; a .{kind} file has "
            f"{len(parts)}"
        )
    found = [
        _parsed_message(name + part, lines, source)
        for part, lines in zip(parts, sections, strict=True)
    ]
    if kind == "srv":
        found += _service(name)
    elif kind == "action":
        found += _action(name)
    return {one.name: one for one in found}


def _service(name: str) -> Iterator[MessageDefinition]:
    """Yield what belongs to a service beside request and response (REP 2012, REP 2016).

    These are its `_Event` message, and the description of the service as a whole, which is never
    sent, but whose hash identifies the service.
    """
    request, response, event = (f"{name}_{part}" for part in ("Request", "Response", "Event"))
    yield MessageDefinition(
        event,
        (
            FieldDefinition("info", "service_msgs/msg/ServiceEventInfo"),
            FieldDefinition("request", request, 0, most=1),
            FieldDefinition("response", response, 0, most=1),
        ),
    )
    yield MessageDefinition(
        name,
        (
            FieldDefinition("request_message", request),
            FieldDefinition("response_message", response),
            FieldDefinition("event_message", event),
        ),
    )


def _action(name: str) -> Iterator[MessageDefinition]:
    """Yield the types by which ROS 2 implements an action: two services and the feedback topic.

    The third service and the status topic have the same types for all actions:
    `action_msgs/srv/CancelGoal` and `action_msgs/msg/GoalStatusArray`.
    """
    goal_id = FieldDefinition("goal_id", "unique_identifier_msgs/msg/UUID")
    send_goal, get_result = f"{name}_SendGoal", f"{name}_GetResult"
    yield MessageDefinition(
        f"{send_goal}_Request", (goal_id, FieldDefinition("goal", f"{name}_Goal"))
    )
    yield MessageDefinition(
        f"{send_goal}_Response",
        (
            FieldDefinition("accepted", "bool"),
            FieldDefinition("stamp", "builtin_interfaces/msg/Time"),
        ),
    )
    yield from _service(send_goal)
    yield MessageDefinition(f"{get_result}_Request", (goal_id,))
    yield MessageDefinition(
        f"{get_result}_Response",
        (FieldDefinition("status", "int8"), FieldDefinition("result", f"{name}_Result")),
    )
    yield from _service(get_result)
    feedback = f"{name}_FeedbackMessage"
    yield MessageDefinition(feedback, (goal_id, FieldDefinition("feedback", f"{name}_Feedback")))
    members = {
        "goal": f"{name}_Goal",
        "result": f"{name}_Result",
        "feedback": f"{name}_Feedback",
        "send_goal_service": send_goal,
        "get_result_service": get_result,
        "feedback_message": feedback,
    }
    yield MessageDefinition(
        name, tuple(FieldDefinition(member, one) for member, one in members.items())
    )


def _parsed_message(name: str, lines: list[tuple[int, str]], source: str) -> MessageDefinition:
    fields: dict[str, FieldDefinition] = {}
    constants: dict[str, ConstantDefinition] = {}
    for number, line in lines:
        try:
            one = _parsed_line(line, name.split("/")[0])
            if one.name in fields or one.name in constants:
                raise ValueError(f"{one.name} is defined twice")
            if len(fields) + len(constants) == _MOST_FIELDS:
                raise ValueError(f"a message has at most {_MOST_FIELDS} fields and constants")
        except ValueError as error:
            kind = UnsupportedDefinition if isinstance(error, _Unsupported) else DefinitionError
            reason = str(error)[:_LONGEST_REASON]
            raise kind(f"{source}:{number}: {line[:200]!r}: {reason}") from error
        if isinstance(one, FieldDefinition):
            fields[one.name] = replace(one, line=number)
        else:
            constants[one.name] = one
    if not fields:
        fields[PLACEHOLDER] = FieldDefinition(PLACEHOLDER, "uint8")
    return MessageDefinition(name, tuple(fields.values()), tuple(constants.values()))


def _parsed_line(line: str, package: str) -> FieldDefinition | ConstantDefinition:
    described, rest = _first_word(line)
    match = _ELEMENT.fullmatch(described)
    if match is None:
        raise ValueError(f"{described[:60]!r} is not a type such as float64, string<=10 or Point[]")
    element = _element(match["name"], package)
    if match["text_most"] and element != "string":
        raise ValueError("only a string or a sequence has a bound")
    text_most = int(match["text_most"]) if match["text_most"] else None
    name, equals, value = rest.partition("=")
    if equals and _CONSTANT_NAME.fullmatch(name.strip()):
        if match["several"] or element not in _PRIMITIVES:
            raise ValueError("a constant is a single number, bool or string")
        return ConstantDefinition(name.strip(), element, _value(element, value.strip(), text_most))
    name, value = _first_word(rest)
    if not _FIELD_NAME.fullmatch(name):
        raise ValueError(
            f"{name[:60]!r} is not the name of a field: lower case, digits and single underscores"
        )
    if iskeyword(name):
        raise _Unsupported(f"a field named {name} is not supported: it is a keyword of Python")
    count = most = None
    if match["several"]:
        size = int(match["count"] or 0)
        if size > _MOST_ITEMS or (match["count"] and not size) or (match["bounded"] and not size):
            raise ValueError(f"an array or bounded sequence has 1 to {_MOST_ITEMS} elements")
        count, most = (0, size) if match["bounded"] else (size, None)
        if count > _MOST_UNROLLED and (element == "string" or "/" in element):
            raise _Unsupported(
                f"arrays of more than {_MOST_UNROLLED} strings or messages are not supported"
            )
    one = FieldDefinition(name, element, count, most, text_most)
    return replace(one, default=_default(one, value)) if value else one


def _first_word(text: str) -> tuple[str, str]:
    """Return what stands before and after the first blanks."""
    first, *rest = text.split(maxsplit=1) or [""]
    return first, rest[0].strip() if rest else ""


def _element(name: str, package: str) -> str:
    """Return a primitive, or the full name of a message type."""
    if name == "char":  # as rosidl_adapter does: a char of ROS 1 was unsigned
        return "uint8"
    if name in _PRIMITIVES:
        return name
    if name == "wstring":
        raise _Unsupported("wstring is not supported; use string, which is UTF-8")
    *packages, last = name.split("/")
    if not last[0].isupper():
        raise ValueError(f"there is no type {name}")
    return f"{packages[0] if packages and packages[0] != 'msg' else package}/msg/{last}"


def _default(one: FieldDefinition, text: str) -> Any:
    if one.element not in _PRIMITIVES:
        raise ValueError("only fields of primitive types have a default")
    if one.count is None:
        return _value(one.element, text, one.text_most)
    if one.element == "bool":
        text = _AS_PYTHON.sub(lambda word: word[0].title(), text)
    try:
        items = ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError) as error:
        raise ValueError(f"{text!r} is not a list such as [1, 2]") from error
    if not isinstance(items, list | tuple):
        raise ValueError(f"{text!r} is not a list such as [1, 2]")
    if one.count and len(items) != one.count:
        raise ValueError(f"an array of {one.count} has {len(items)} default values")
    if one.most is not None and len(items) > one.most:
        raise ValueError(f"{len(items)} default values, more than {one.most}")
    return tuple(_value(one.element, str(item), one.text_most) for item in items)


def _value(element: str, text: str, text_most: int | None) -> bool | int | float | str:
    """Return the value of a constant or default as its type; `ValueError` if it does not fit."""
    if element == "string":
        if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
            text = text[1:-1].replace(f"\\{text[0]}", text[0])
        if text_most is not None and len(text.encode()) > text_most:
            raise ValueError(f"{text!r} is longer than {text_most} bytes")
        return text
    if element == "bool":
        if text.lower() not in ("true", "false", "1", "0"):
            raise ValueError(f"{text!r} is not a bool: true or false")
        return text.lower() in ("true", "1")
    if element in ("float32", "float64"):
        return float(text)
    number = int(text) if text.isdecimal() else int(text, 0)  # 007 is 7
    low, high = INTEGER_LIMITS[element]
    if not low <= number <= high:
        raise ValueError(f"{number} is not a {element}: {low} to {high}")
    return number
