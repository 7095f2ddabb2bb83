"""Finds the classes of faults and invariants by entry point, or as `package.module:Class`."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from cairn.deployment.problems import suggestion
from cairn.runtime.parameters import error_reason

T = TypeVar("T")


@dataclass(frozen=True)
class KindGroup(Generic[T]):
    """Classes that an entry point group offers, all of them derived from `base`.

    `config_type` of each is the class of its parameters; an instance of it is its only argument.
    """

    entry_points: str
    noun: str
    base: type[T]

    def names(self) -> list[str]:
        """Return the names of the installed kinds, sorted."""
        return sorted(entry_points(group=self.entry_points).names)


def instance_of(group: KindGroup[T], kind: str, parameters: dict[str, Any]) -> T:
    """Return a new instance of a kind with these parameters.

    Raises `ValueError` if there is no such kind, it cannot be imported, or it rejects them.
    """
    cls: Any = _class_of(group, kind)
    try:
        config = cls.config_type.model_validate(parameters)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, one['loc']))}: {error_reason(one)}" for one in error.errors()
        )
        raise ValueError(f"{group.noun} {kind}: parameters: {problems}") from error
    made: T = cls(config)
    return made


def _class_of(group: KindGroup[T], kind: str) -> type[T]:
    target = kind
    if ":" not in kind:
        found = [one.value for one in entry_points(group=group.entry_points) if one.name == kind]
        if len(set(found)) != 1:
            known = group.names()
            wrong = "several packages offer" if found else "there is no"
            raise ValueError(
                f"{wrong} {group.noun} {kind}; {suggestion(kind, known)} (installed: "
                f"{', '.join(known)}; package.module:Class names a class directly)"
            )
        target = found[0]
    module, _, name = target.partition(":")
    try:
        cls = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"{group.noun} {kind} cannot be imported: {error}; correct the name, or install the "
            "package that holds it"
        ) from error
    if not isinstance(cls, type) or not issubclass(cls, group.base):
        raise ValueError(
            f"{target} is not a class of kind {group.noun}; derive it from "
            f"cairn_lab.campaign.{group.base.__name__}"
        )
    return cls
