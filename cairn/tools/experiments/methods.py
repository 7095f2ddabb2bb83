"""The ways of keeping a visual map that are compared: what each pair of components is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Method:
    """A localizer and a map builder with parameters of their own; `title` names it in reports."""

    name: str
    title: str
    localizer: Mapping[str, Any] = field(default_factory=dict)
    map_builder: Mapping[str, Any] = field(default_factory=dict)


OURS = Method("ours", "ours (likelihood ratio)", {"mode": "lr"}, {"rule": "reliability"})
LETTER = Method("letter", "paper, to the letter", {"mode": "paper_rule"}, {"rule": "paper_rule"})
PAPER = Method("paper", "paper, clamped", {"mode": "paper"}, {"rule": "reliability"})
CHI_SQUARE = Method(
    "chi_square", "chi-square gate", {"mode": "chi_square"}, {"rule": "reliability"}
)
PERSISTENCE = Method("persistence", "persistence filter", {"mode": "lr"}, {"rule": "persistence"})
NO_UPDATE = Method("no_update", "no update", {"mode": "lr"}, {"update_objects": False})

# A filter without doubt, as the paper's seems to be: what it does when the map is wrong.
_WORD = {"mode": "lr", "fusion": "certain", "independence": 1.0}
OURS_AT_ITS_WORD = Method("word", "ours, objects at their word", _WORD)
NO_UPDATE_AT_ITS_WORD = Method(
    "word_no_update", "no update, objects at their word", _WORD, {"update_objects": False}
)

ABLATION = (OURS, LETTER, PAPER, CHI_SQUARE, PERSISTENCE, NO_UPDATE)
