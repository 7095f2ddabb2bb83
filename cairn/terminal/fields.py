"""Fields of messages as a user names them: values by path; messages made of plain values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import yaml

from cairn.deployment.problems import suggestion
from cairn.errors import CairnError
from cairn.limits.yaml import parse_yaml
from cairn.schemas.definitions import PLACEHOLDER
from cairn.schemas.message import Field, InvalidMessage, fields_of, type_name

_STEP = re.compile(r"\.?([A-Za-z_]\w*)|\.(\d+)|\[(-?\d+)\]|\[(-?\d*):(-?\d*)(?::(-?\d*))?\]")
_MAX_PATHS = 200  # listed for a type


@dataclass(frozen=True)
class FieldPath:
    """The path of a field in the messages of a type: `pose.position.x`, `ranges[0:100:10]`.

    Attributes:
        text: as the user wrote it.
        steps: names of fields, indices and slices.
        element: ROS 2 name of the primitive that it leads to; "" for a message.
        is_sequence: whether it leads to several values.
    """

    text: str
    steps: tuple[str | int | slice, ...]
    element: str
    is_sequence: bool

    @property
    def is_numeric(self) -> bool:
        """Whether it leads to numbers, or true and false."""
        return self.element not in ("", "string")

    def value(self, message: Any) -> Any:
        """Return the value in a message; None if a sequence has no such element."""
        return _value(message, self.steps)


def field_path(message: type[Any], text: str) -> FieldPath:
    """Return the path of a field of a message class.

    Raises `CairnError`, with what is allowed in its place, if there is no such field.
    """
    steps = tuple(_steps(text))
    kind: str | type[Any] = message
    within = type_name(message)
    is_sequence = several = False
    for step in steps:
        if isinstance(step, str):
            if is_sequence:
                raise CairnError(
                    f"{text}: {within} is a sequence; write an index or a slice before .{step}, "
                    f"such as [0].{step} or [:].{step}"
                )
            if not isinstance(kind, type):
                raise CairnError(f"{text}: {within} is of type {kind} and has no fields")
            field = _field(kind, step, text)
            kind, is_sequence = field.element, field.count is not None
            within = f"{step} of {type_name(message)}"
        elif not is_sequence:
            raise CairnError(f"{text}: {within} is not a sequence; leave out the index")
        else:
            is_sequence = False
            several = several or isinstance(step, slice)
    element = kind if isinstance(kind, str) else ""
    return FieldPath(text, steps, element, several or is_sequence)


def field_paths(message: type[Any]) -> list[FieldPath]:
    """Return the paths of all numbers and texts in the messages of a class, at most 200."""
    return [field_path(message, path) for path in islice(_leaves(message), _MAX_PATHS)]


def message_of(message: type[Any], values: object) -> Any:
    """Return a message of a class made of plain values; fields that are not given have defaults.

    Raises `CairnError` with the field and what is allowed if a value does not fit.
    """
    return _message(message, values, "")


def yaml_value(name: str, text: str) -> Any:
    """Return the value that is given for a name in YAML; `CairnError` if it is not YAML."""
    try:
        return parse_yaml(text)
    except (yaml.YAMLError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise CairnError(f"{name}: {text!r} is not a YAML value: {reason}") from error


def _message(message: type[Any], values: object, path: str) -> Any:
    name = type_name(message)
    if not isinstance(values, Mapping):
        first = next((f"{field.name}: ..." for field in _fields_of(message)), "")
        raise CairnError(
            f"{name}: {path or 'the message'} = {values!r}: must be a mapping of fields, as in "
            f"'{{{first}}}'"
        )
    arguments = {}
    for key, value in values.items():
        field = _field(message, str(key), f"{path}.{key}" if path else str(key))
        inside = f"{path}.{field.name}" if path else field.name
        if isinstance(field.element, type) and field.count is None:
            arguments[field.name] = _message(field.element, value, inside)
        elif isinstance(field.element, type) and isinstance(value, list):
            arguments[field.name] = [
                _message(field.element, item, f"{inside}[{index}]")
                for index, item in enumerate(value)
            ]
        else:
            arguments[field.name] = value
    try:
        return message(**arguments)
    except InvalidMessage as error:
        whole = f"{path}.{error.path}" if path else error.path
        raise CairnError(f"{name}: {whole} = {error.value}: {error.reason}") from None


def _field(message: type[Any], name: str, text: str) -> Field:
    fields = {field.name: field for field in _fields_of(message)}
    if name not in fields:
        close = suggestion(name, fields)
        every = "" if "expected" in close else f" The fields are {', '.join(fields)}"
        raise CairnError(f"{text}: {type_name(message)} has no field {name}; {close}{every}")
    return fields[name]


def _steps(text: str) -> Iterator[str | int | slice]:
    position = 0
    while position < len(text):
        found = _STEP.match(text, position)
        is_name, has_dot = found is not None and found[1] is not None, text[position] == "."
        if found is None or (is_name and has_dot != (position > 0)) or not (is_name or position):
            raise CairnError(
                f"{text!r} is not a field; write it as pose.position.x, ranges[0] or ranges[0:9]"
            )
        position = found.end()
        name, after_dot, index, first, last, step = found.groups()
        if name is not None:
            yield name
        elif first is None:
            yield int(after_dot or index)
        else:
            bounds = [int(one) if one else None for one in (first, last, step)]
            if bounds[2] == 0:
                raise CairnError(f"{text}: the step of a slice must not be 0")
            yield slice(*bounds)
    if not text:
        raise CairnError("the field is empty; write it as pose.position.x")


def _value(value: Any, steps: tuple[str | int | slice, ...]) -> Any:
    for number, step in enumerate(steps):
        if isinstance(step, str):
            value = getattr(value, step)
        elif isinstance(step, int):
            if not -len(value) <= step < len(value):
                return None
            value = value[step]
        else:
            rest = steps[number + 1 :]
            return [_value(one, rest) for one in value[step]] if rest else value[step]
    return value.item() if isinstance(value, np.generic) else value


def _fields_of(message: type[Any]) -> list[Field]:
    """Return the fields that a message has for users."""
    return [field for field in fields_of(message) if field.name != PLACEHOLDER]


def _leaves(message: type[Any]) -> Iterator[str]:
    for field in _fields_of(message):
        index = "" if field.count is None else "[0]"
        if isinstance(field.element, type):
            for path in _leaves(field.element):
                yield f"{field.name}{index}.{path}"
        else:
            yield f"{field.name}{index}"


def plain_values(topic: str, text: str) -> Mapping[str, Any]:
    """Return the fields in a text of YAML or JSON; `CairnError` if it is not a mapping."""
    values = yaml_value(topic, text)
    if not isinstance(values, Mapping):
        raise CairnError(f"{text!r} is not a mapping of fields; write it as '{{data: 1}}'")
    return values
