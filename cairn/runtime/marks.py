"""Marks on parameters: what their values mean to those who look after files and devices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_args

from pydantic import BaseModel

M = TypeVar("M")


@dataclass(frozen=True)
class IsRead:
    """Marks a parameter whose value is the path of a file or folder that must be there."""


ReadPath = Annotated[Path, IsRead()]
"""A file or folder that the component reads: `cairn doctor` looks whether it is there."""


@dataclass(frozen=True)
class Marked(Generic[M]):
    """A parameter that bears a mark: its dotted name, its value, and the group that it is in."""

    name: str
    value: Any
    mark: M
    group: BaseModel


def marked(config: BaseModel, kind: type[M]) -> Iterator[Marked[M]]:
    """All parameters that bear a mark of that kind, groups' own among them, but those of None."""
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            for inner in marked(value, kind):
                yield Marked(f"{name}.{inner.name}", inner.value, inner.mark, inner.group)
        elif value is not None:
            for mark in _marks([*field.metadata, field.annotation], kind):
                yield Marked(name, value, mark, config)


def _marks(parts: list[Any], kind: type[M]) -> Iterator[M]:
    """The marks within an annotation, in that of `ReadPath | None` too."""
    for part in parts:
        if isinstance(part, kind):
            yield part
        else:
            yield from _marks(list(get_args(part)), kind)
