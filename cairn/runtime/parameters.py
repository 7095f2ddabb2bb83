"""Parameters: a component's configuration as a strict model, described and changed by name."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from types import EllipsisType, NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Final,
    Generic,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
)

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from cairn.errors import CairnError
from cairn.runtime.child_spec import LogLevel
from cairn.runtime.robot import QUANTITIES

C = TypeVar("C", bound="Config")
M = TypeVar("M")

_MAX_ERRORS, _MAX_SHOWN = 5, 100
"""Errors in one rejection; characters of a value or name in it."""


class Config(BaseModel):
    """Base class of every component's configuration, a pydantic model.

    Its fields are the parameters. They should have bounds and a description with the unit:
    `rate: float = Field(10.0, gt=0, le=100, description="Scans per second [Hz].")`. Unknown
    parameters, NaN and infinities are rejected, and so are true and false for numbers; instances
    are immutable.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False
    )

    @model_validator(mode="before")
    @classmethod
    def _no_boolean_as_number(cls, values: object) -> object:
        """Replace booleans given for numbers by texts: these pydantic rejects, naming the field."""
        if not isinstance(values, Mapping):
            return values
        return {
            name: str(value).lower() if isinstance(value, bool) and cls._is_number(name) else value
            for name, value in values.items()
        }

    @classmethod
    def _is_number(cls, name: str) -> bool:
        field = cls.model_fields.get(name)
        kinds = set() if field is None else _kinds(field.annotation)
        return bool not in kinds and not kinds.isdisjoint({int, float})


class Mount(Config):
    """Parameter group: the pose of a sensor on the robot, in the frame of its base."""

    x: float = Field(0.0, ge=-5, le=5, description="Ahead of the base's center [m].")
    y: float = Field(0.0, ge=-5, le=5, description="Left of it [m].")
    theta: float = Field(0.0, ge=-math.pi, le=math.pi, description="Turned to the left [rad].")

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y [m], heading [rad]."""
        return self.x, self.y, self.theta


class ParameterRejected(CairnError):
    """A change of parameters was rejected, by the model or by the component; nothing changed.

    A component raises it in `on_parameters`.
    """


@dataclass(frozen=True)
class ReadPathMark:
    """Marks a parameter whose value is the path of a file or folder that must exist."""


ReadPath = Annotated[Path, ReadPathMark()]
"""Type of a parameter: a file or folder that the component reads.

`cairn doctor` checks that it exists and can be read.
"""


@dataclass(frozen=True)
class SensorFrameMark:
    """Marks a parameter whose value is a frame that is mounted on the robot."""


SensorFrame = Annotated[str, Field(min_length=1), SensorFrameMark()]
"""Type of a parameter: the frame of a sensor, which the robot should have.

`cairn check` reports it if the deployment has frames, but not this one.
"""


@dataclass(frozen=True)
class FromRobot:
    """Marks a parameter whose default is a quantity of the deployment's section `robot`.

    `radius: Annotated[float, FromRobot("shape.radius_m")] = Field(0.2, gt=0)`: if the section does
    not give the quantity, the default is that of the field. `QUANTITIES` has their names.
    """

    quantity: str

    def __post_init__(self) -> None:
        """Raise `CairnError` if there is no such quantity."""
        if self.quantity not in QUANTITIES:
            close = get_close_matches(self.quantity, QUANTITIES, n=1)
            hint = f"did you mean {close[0]}?" if close else f"give one of {sorted(QUANTITIES)}"
            raise CairnError(f"the robot has no quantity {self.quantity}; {hint}")


@dataclass(frozen=True)
class ParameterDescription:
    """One parameter as shown to an operator; parameters in groups have dotted names.

    `range` has the least and the greatest number, each None without a limit.
    """

    name: str
    value: Any
    type: str
    description: str
    bounds: str
    range: tuple[float | None, float | None] = (None, None)


ServiceIntrospection = Literal["off", "metadata", "contents"]
"""What a component publishes of the calls of its services: see `cairn.runtime.service_events`."""

LOG_LEVEL: Final = "log_level"
SERVICE_INTROSPECTION: Final = "service_introspection"
_COMMON: Final[Mapping[str, tuple[Any, str]]] = {
    LOG_LEVEL: (LogLevel, "Lowest level of the records that the component logs."),
    SERVICE_INTROSPECTION: (
        ServiceIntrospection,
        "What is published of the calls of its services and actions, on topic _service_event "
        "below each: nothing, who called when, or also requests and responses.",
    ),
}
COMMON_PARAMETERS: Final = tuple(_COMMON)
"""Names of the parameters that every component has beside those of its configuration."""


def describe_common(values: Mapping[str, str]) -> list[ParameterDescription]:
    """Return the parameters that every component has, with their values."""
    return [
        ParameterDescription(name, values[name], _type_name(kind), meaning, "")
        for name, (kind, meaning) in _COMMON.items()
    ]


def checked_common(name: str, value: object) -> str:
    """Return a value of a parameter that every component has; raises `ParameterRejected`."""
    allowed = get_args(_COMMON[name][0])
    if value not in allowed:
        raise ParameterRejected(
            f"parameter {name} = {_shown(value)} rejected: should be one of {', '.join(allowed)}"
        )
    return str(value)


def describe_parameters(config: Config) -> list[ParameterDescription]:
    """Return all parameters of a configuration, in order of declaration."""
    return [
        ParameterDescription(
            name,
            value,
            _type_name(field.annotation),
            field.description or "",
            bounds_text(field),
            _range(field),
        )
        for name, value, field in _leaves(config, "")
    ]


def with_changes(config: C, changes: Mapping[str, Any]) -> C:
    """Return the configuration with all changes made, given by (dotted) parameter name.

    Raises `ParameterRejected`, with parameter, value and bound, if any of them is invalid.
    """
    fields = {name: field for name, _, field in _leaves(config, "")}
    data = config.model_dump()
    for name, value in changes.items():
        if name not in fields:
            raise ParameterRejected(_unknown(name, list(fields)))
        *groups, leaf = name.split(".")
        target = data
        for group in groups:
            target = target[group]
        target[leaf] = value
    try:
        return type(config).model_validate(data)
    except ValidationError as error:
        details = error.errors()
        rejections = [_rejection(detail, fields, changes) for detail in details[:_MAX_ERRORS]]
        if len(details) > _MAX_ERRORS:
            rejections.append(f"and {len(details) - _MAX_ERRORS} more")
        raise ParameterRejected("; ".join(rejections)) from error


def error_reason(detail: ErrorDetails) -> str:
    """Return pydantic's message without its opening: "should be greater than or equal to 10"."""
    text = detail["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return re.sub(r"^\w+ (?=should )", "", text).replace("valid dictionary", "mapping")


def bounds_text(field: FieldInfo) -> str:
    """Return a field's bounds as text: ">= 10, <= 200000"; empty if it has none."""
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "multiple_of": "a multiple of"}
    words = {"min_length": "length >=", "max_length": "length <=", "pattern": "pattern"}
    bounds = []
    for constraint in (*field.metadata, *_constraints_within(field.annotation)):
        for attribute, sign in (signs | words).items():
            limit = getattr(constraint, attribute, None)
            if limit is not None:
                one = attribute == "min_length" and limit == 1
                shown = f"{limit:.7g}" if isinstance(limit, float) else limit
                bounds.append("not empty" if one else f"{sign} {shown}")
    return ", ".join(bounds)


def _range(field: FieldInfo) -> tuple[float | None, float | None]:
    """Return the least and the greatest value that a field's bounds name, excluded or not."""
    low = high = None
    for constraint in (*field.metadata, *_constraints_within(field.annotation)):
        for attribute in ("gt", "ge"):
            low = getattr(constraint, attribute, None) if low is None else low
        for attribute in ("lt", "le"):
            high = getattr(constraint, attribute, None) if high is None else high
    return low, high


@dataclass(frozen=True)
class MarkedParameter(Generic[M]):
    """A parameter with a mark: its dotted name, its value, and the group that it is in."""

    name: str
    value: Any
    mark: M
    group: BaseModel


def marked_parameters(config: BaseModel, kind: type[M]) -> Iterator[MarkedParameter[M]]:
    """Yield all parameters, also those in groups, with a mark of class `kind`, unless None."""
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            for inner in marked_parameters(value, kind):
                yield MarkedParameter(f"{name}.{inner.name}", inner.value, inner.mark, inner.group)
        elif value is not None:
            for mark in _marks_within([*field.metadata, field.annotation], kind):
                yield MarkedParameter(name, value, mark, config)


def field_marks(model: type[BaseModel], kind: type[M]) -> Iterator[tuple[str, M]]:
    """Yield the name of each field of a model that has a mark of class `kind`, with the mark."""
    for name, field in model.model_fields.items():
        for mark in _marks_within([*field.metadata, field.annotation], kind):
            yield name, mark


def _marks_within(parts: list[Any], kind: type[M]) -> Iterator[M]:
    """Yield the marks in the parts of an annotation, also in that of `ReadPath | None`."""
    for part in parts:
        if isinstance(part, kind):
            yield part
        else:
            yield from _marks_within(list(get_args(part)), kind)


def _constraints_within(annotation: Any) -> Iterator[Any]:
    """Yield the constraints in an annotation such as `Annotated[int, Field(ge=0)] | None`."""
    if get_origin(annotation) not in (Annotated, Union, UnionType):
        return  # constraints of a list's items are not its own
    for part in get_args(annotation):
        if isinstance(part, FieldInfo):
            yield from part.metadata
        else:
            yield from _constraints_within(part)


def _leaves(config: BaseModel, prefix: str) -> Iterator[tuple[str, Any, FieldInfo]]:
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value, field


def _kinds(annotation: Any) -> set[Any]:
    """Return the types that a value may have by an annotation such as `Annotated[float, ...]`."""
    if get_origin(annotation) is Annotated:
        return _kinds(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return set().union(*map(_kinds, get_args(annotation)))
    return {annotation}


def _type_name(annotation: Any) -> str:
    """Return a type as an operator reads it, without modules and marks: "Path | None"."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is NoneType or annotation is None:
        return "None"
    if isinstance(annotation, EllipsisType):
        return "..."
    if origin is Annotated:
        return _type_name(arguments[0])
    if origin in (Union, UnionType):
        return " | ".join(map(_type_name, arguments))
    if origin is Literal:
        return f"Literal[{', '.join(map(repr, arguments))}]"
    name = getattr(origin or annotation, "__name__", str(annotation))
    return f"{name}[{', '.join(map(_type_name, arguments))}]" if arguments else name


def _rejection(
    detail: ErrorDetails, fields: Mapping[str, FieldInfo], changes: Mapping[str, Any]
) -> str:
    path = ".".join(str(step) for step in detail["loc"])
    name = next((name for name in fields if path == name or path.startswith(f"{name}.")), None)
    if name is None:
        values = ", ".join(f"{name} = {_shown(value)}" for name, value in changes.items())
        return f"{values} rejected: {error_reason(detail)}"
    limits = f" (allowed: {bounds_text(fields[name])})" if bounds_text(fields[name]) else ""
    return f"parameter {path} = {_shown(detail['input'])} rejected: {error_reason(detail)}{limits}"


def _unknown(name: str, known: list[str]) -> str:
    group = [other for other in known if other.startswith(f"{name}.")]
    if group:
        return f"{name} is a group of parameters; change one of {', '.join(group)}"
    close = get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}?" if close else f"the parameters are {', '.join(known)}"
    return f"there is no parameter {name[:_MAX_SHOWN]}; {hint}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."
