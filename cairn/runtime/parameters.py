"""Parameters: a component's configuration as a strict model, described and changed by name."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import reduce
from operator import or_
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Generic, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from cairn.errors import CairnError

C = TypeVar("C", bound="Config")


class Config(BaseModel):
    """Base of every component's configuration; fields have bounds, and descriptions with units."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False
    )


class ParameterRejected(CairnError):  # noqa: N818 - reads as what a component says
    """A change of parameters was refused, by the model or by the component; nothing changed."""


@dataclass(frozen=True)
class Parameter:
    """One parameter as an operator sees it; nested models give dotted names."""

    name: str
    value: Any
    type: str
    description: str
    bounds: str


def describe_parameters(config: Config) -> list[Parameter]:
    """All parameters of a configuration, in order of declaration."""
    return [
        Parameter(name, value, _type(field), field.description or "", bounds_text(field))
        for name, value, field in _leaves(config, "")
    ]


def with_changes(config: C, changes: Mapping[str, Any]) -> C:
    """The configuration with all the changes made, given by (dotted) parameter name.

    Raises `ParameterRejected`, naming parameter, value and bound, if any of them is refused.
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
        raise ParameterRejected(
            "; ".join(_refusal(detail, fields, changes) for detail in error.errors())
        ) from error


def error_reason(detail: ErrorDetails) -> str:
    """Pydantic's message without its opening words: "should be greater than or equal to 10"."""
    text = detail["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return re.sub(r"^\w+ (?=should )", "", text).replace("valid dictionary", "mapping")


def bounds_text(field: FieldInfo) -> str:
    """A field's bounds as text: ">= 10, <= 200000"; empty if it has none."""
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "multiple_of": "a multiple of"}
    words = {"min_length": "length >=", "max_length": "length <=", "pattern": "pattern"}
    found = []
    for constraint in (*field.metadata, *_within(field.annotation)):
        for attribute, sign in (signs | words).items():
            limit = getattr(constraint, attribute, None)
            if limit is not None:
                one = attribute == "min_length" and limit == 1
                told = f"{limit:.7g}" if isinstance(limit, float) else limit
                found.append("not empty" if one else f"{sign} {told}")
    return ", ".join(found)


def _within(annotation: Any) -> Iterator[Any]:
    """The constraints within an annotation, as of `Annotated[int, Field(ge=0)] | None`."""
    if get_origin(annotation) not in (Annotated, Union, UnionType):
        return  # those of a list's items are not its own
    for part in get_args(annotation):
        if isinstance(part, FieldInfo):
            yield from part.metadata
        else:
            yield from _within(part)


def _leaves(config: BaseModel, prefix: str) -> Iterator[tuple[str, Any, FieldInfo]]:
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value, field


def _type(field: FieldInfo) -> str:
    annotation = _plain(field.annotation)
    if isinstance(annotation, type) and not hasattr(annotation, "__args__"):
        return annotation.__name__
    return str(annotation).replace("typing.", "")


def _plain(annotation: Any) -> Any:
    """Without the marks (`cairn.runtime.parameters`), which are not for an operator."""
    parts = get_args(annotation)
    if get_origin(annotation) is Annotated:
        return _plain(parts[0])
    if get_origin(annotation) in (Union, UnionType):
        return reduce(or_, map(_plain, parts))
    return annotation


def _refusal(
    detail: ErrorDetails, fields: Mapping[str, FieldInfo], changes: Mapping[str, Any]
) -> str:
    path = ".".join(str(step) for step in detail["loc"])
    name = next((name for name in fields if path == name or path.startswith(f"{name}.")), None)
    if name is None:
        given = ", ".join(f"{name} = {value!r}" for name, value in changes.items())
        return f"{given} refused: {error_reason(detail)}"
    limits = f" (allowed: {bounds_text(fields[name])})" if bounds_text(fields[name]) else ""
    return f"parameter {path} = {detail['input']!r} refused: {error_reason(detail)}{limits}"


def _unknown(name: str, known: list[str]) -> str:
    group = [other for other in known if other.startswith(f"{name}.")]
    if group:
        return f"{name} is a group of parameters; change one of {', '.join(group)}"
    close = get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}?" if close else f"the parameters are {', '.join(known)}"
    return f"there is no parameter {name}; {hint}"


M = TypeVar("M")


@dataclass(frozen=True)
class ReadPathMark:
    """Marks a parameter whose value is the path of a file or folder that must be there."""


ReadPath = Annotated[Path, ReadPathMark()]
"""A file or folder that the component reads: `cairn doctor` looks whether it is there."""


@dataclass(frozen=True)
class MarkedParameter(Generic[M]):
    """A parameter that bears a mark: its dotted name, its value, and the group that it is in."""

    name: str
    value: Any
    mark: M
    group: BaseModel


def marked_parameters(config: BaseModel, kind: type[M]) -> Iterator[MarkedParameter[M]]:
    """All parameters that bear a mark of that kind, groups' own among them, but those of None."""
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            for inner in marked_parameters(value, kind):
                yield MarkedParameter(f"{name}.{inner.name}", inner.value, inner.mark, inner.group)
        elif value is not None:
            for mark in _marks([*field.metadata, field.annotation], kind):
                yield MarkedParameter(name, value, mark, config)


def _marks(parts: list[Any], kind: type[M]) -> Iterator[M]:
    """The marks within an annotation, in that of `ReadPath | None` too."""
    for part in parts:
        if isinstance(part, kind):
            yield part
        else:
            yield from _marks(list(get_args(part)), kind)


class Mount(Config):
    """The pose of a sensor on the robot, in the frame of its base."""

    x: float = Field(0.0, ge=-5, le=5, description="Ahead of the base's center [m].")
    y: float = Field(0.0, ge=-5, le=5, description="Left of it [m].")
    theta: float = Field(0.0, ge=-math.pi, le=math.pi, description="Turned to the left [rad].")

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y [m], heading [rad]."""
        return self.x, self.y, self.theta
