"""Parameters that kinds of faults have in common: targets, drawn by name, and durations."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from random import Random
from typing import Annotated

from pydantic import Field, model_validator

from cairn.runtime.parameters import Config

Patterns = Annotated[tuple[str, ...], Field(max_length=100)]


def matching(names: Iterable[str], patterns: Patterns, exclude: Patterns = ()) -> list[str]:
    """Return the names that match one of the patterns, and none of those to exclude."""
    return [
        name
        for name in names
        if any(fnmatchcase(name, one) for one in patterns)
        and not any(fnmatchcase(name, one) for one in exclude)
    ]


class Targets(Config):
    """The components that may be drawn as target."""

    components: Patterns = Field(
        ("*",), description="Names of components with a process of their own, as patterns."
    )
    exclude: Patterns = Field((), description="Names not to draw, as patterns.")


class Duration(Config):
    """How long a fault lasts, drawn uniformly."""

    shortest_s: float = Field(1.0, gt=0, le=3600, description="Shortest duration [s].")
    longest_s: float = Field(10.0, gt=0, le=3600, description="Longest duration [s].")

    @model_validator(mode="after")
    def _in_order(self) -> Duration:
        if self.shortest_s > self.longest_s:
            raise ValueError(f"shortest_s = {self.shortest_s:g} exceeds {self.longest_s:g}")
        return self

    def draw(self, random: Random) -> float:
        """Return a duration [s]."""
        return round(random.uniform(self.shortest_s, self.longest_s), 2)


class TargetsForTime(Targets, Duration):
    """Targets, and for how long."""
