"""The rules by which evidence changes the visual map, by name."""

from __future__ import annotations

from typing import Literal

from cairn.components.map_builder.letter import judge_to_the_letter
from cairn.components.map_builder.persistence import PersistenceFilter
from cairn.components.map_builder.rule import Rule, judge

RuleName = Literal["reliability", "letter", "persistence"]


def rule_named(name: RuleName) -> Rule:
    """A rule: the one that keeps a robot's map, or one of those that it is compared with."""
    match name:
        case "reliability":
            return judge
        case "letter":
            return judge_to_the_letter
        case "persistence":
            return PersistenceFilter()
