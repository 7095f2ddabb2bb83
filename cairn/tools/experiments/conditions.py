"""Section 4.1 of the paper: uncertainty and error over time, by what was changed and updated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cairn.tools.experiments.errors import Course
from cairn.tools.experiments.statistics import Mean, Rate, mean_of, near_of, ratio_of

Array = NDArray[np.float64]

QUANTITIES = {
    "position_spread": "samples' position [m]",
    "position_sd": "stated position [m]",
    "position_error": "error of position [m]",
    "heading_spread": "samples' heading [rad]",
    "heading_sd": "stated heading [rad]",
    "heading_error": "error of heading [rad]",
}
"""The attributes of a `Course`, and what they are: uncertainty (standard deviation) and error."""

POSITION, HEADING = tuple(QUANTITIES)[:3], tuple(QUANTITIES)[3:]

NEAR = 0.1
"""Off by no more than this share, a quantity is back at what it is in the unchanged room."""

BEFORE, AFTER, REPAIRED = "before", "after", "repaired"
PHASES = {
    BEFORE: "before the change",
    AFTER: "after the change",
    REPAIRED: "from the registration of the moved object on",
}


@dataclass(frozen=True)
class Condition:
    """What was changed, and whether the map follows; `title` names it in reports.

    `reference` is the name of the same without a change: it shows what the change does, and
    nothing else.
    """

    name: str
    title: str
    reference: str
    color: str
    style: str


UNCHANGED = Condition("unchanged", "unchanged, map kept up", "unchanged", "tab:red", "-")
UPDATED = Condition("updated", "changed, map kept up", "unchanged", "tab:green", "--")
UNCHANGED_FIXED = Condition(
    "unchanged_fixed", "unchanged, map fixed", "unchanged_fixed", "tab:orange", "-"
)
NOT_UPDATED = Condition("not_updated", "changed, map fixed", "unchanged_fixed", "tab:blue", ":")
CONDITIONS = (UNCHANGED, UPDATED, UNCHANGED_FIXED, NOT_UPDATED)


def at_its_word(condition: Condition) -> Condition:
    """The same with objects that are fused as if all stood where the map says."""
    return replace(
        condition, name=f"word_{condition.name}", reference=f"word_{condition.reference}"
    )


AT_ITS_WORD = tuple(map(at_its_word, CONDITIONS))
FUSIONS = {
    "objects fused by their reliability": CONDITIONS,
    "objects taken at their word": AT_ITS_WORD,
}


@dataclass(frozen=True)
class Way:
    """One way that was driven: its course by condition, and when [s] what happened."""

    seed: int
    courses: Mapping[str, Course]
    changed_at: float
    registered_at: float | None
    end: float

    def phase(self, condition: str, phase: str) -> Course:
        """That part of a course; empty for `REPAIRED` if nothing was registered."""
        begin, end = {
            BEFORE: (0.0, self.changed_at),
            AFTER: (self.changed_at, self.end),
            REPAIRED: (self.end if self.registered_at is None else self.registered_at, self.end),
        }[phase]
        return self.courses[condition].between(begin, end)


class Figure(BaseModel):
    """One quantity of one condition in one phase: its mean over time, over all runs."""

    model_config = ConfigDict(extra="forbid")

    condition: str = Field(
        description="unchanged or changed room; map kept up (unchanged, updated) or fixed "
        "(unchanged_fixed, not_updated); word_: with objects taken at their word, as if all stood "
        "where the map says, instead of by their reliability."
    )
    phase: str = Field(
        description="before: until the change; after: from it on; repaired: from the registration "
        "of the moved object on, the same time for all conditions."
    )
    quantity: str = Field(
        description="spread: standard deviation of the samples; sd: that which the pose states; "
        "error: of the pose, rms. Of the position [m] or of the heading [rad]."
    )
    value: Mean
    against_unchanged: Mean = Field(
        description="Over that of the unchanged environment, in the same phases of the same ways, "
        "of a map that is kept up, or fixed, alike."
    )
    ways_near_unchanged: Rate = Field(
        description="Ways in which it is within 10 % of that of the unchanged environment."
    )


def figures(ways: Sequence[Way]) -> list[Figure]:
    """All figures of all conditions."""
    found = []
    for phase in PHASES:
        for quantity in QUANTITIES:
            for condition in (*CONDITIONS, *AT_ITS_WORD):
                reference = _means(ways, condition.reference, phase, quantity)
                values = _means(ways, condition.name, phase, quantity)
                found.append(
                    Figure(
                        condition=condition.name,
                        phase=phase,
                        quantity=quantity,
                        value=mean_of(values),
                        against_unchanged=ratio_of(values, reference),
                        ways_near_unchanged=near_of(values, reference, NEAR),
                    )
                )
    return found


def together(ways: Sequence[Way], condition: str, quantity: str) -> tuple[Array, Array]:
    """Stamps (n,) [s] and the quantity (ways, n) over the time that all ways have."""
    steps = min(way.courses[condition].stamps.size for way in ways)
    rows = [getattr(way.courses[condition], quantity)[:steps] for way in ways]
    return ways[0].courses[condition].stamps[:steps], np.array(rows, np.float64)


def _means(ways: Sequence[Way], condition: str, phase: str, quantity: str) -> Array:
    """Of each way (n,) the quantity's mean over time, of errors its root mean square; or NaN."""
    power = 2 if quantity.endswith("_error") else 1
    values = []
    for way in ways:
        row = getattr(way.phase(condition, phase), quantity)
        known = row[np.isfinite(row)]
        values.append(np.mean(known**power) ** (1 / power) if known.size else np.nan)
    return np.array(values, np.float64)
