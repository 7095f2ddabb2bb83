"""Many runs of several methods, summed up, and in words where another is better than ours."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field

from cairn.tools.experiments import text
from cairn.tools.experiments.judging import THERE_M, MoveResult, RunResult
from cairn.tools.experiments.methods import Method
from cairn.tools.experiments.statistics import (
    LEAST_CASES,
    Mean,
    Rate,
    Spread,
    mean_of,
    rate_of,
    root_mean_square_of,
    spread_of,
)

# Who was seen less often after the move is not asked for.
ENOUGH_SIGHTINGS = 5
_NAN = float("nan")


class MethodSummary(BaseModel):
    """All runs of one method."""

    model_config = ConfigDict(extra="forbid")

    method: str
    title: str
    runs: int = Field(description="Runs that count.")
    moved: int = Field(description="Objects that were moved in them, sighted or not.")
    recall: Rate = Field(
        description="Moved objects that were removed, or before the move removed and then "
        "registered rightly, of those sighted at least 5 times after."
    )
    recall_by_views: Rate = Field(
        description="The same of those sighted at least 5 times from poses that differ by 0.15 m "
        "or 0.2 rad."
    )
    precision: Rate = Field(description="Removals of objects that did not stand there, of all.")
    false_removals: Rate = Field(description="Removals of objects that stood there, by sightings.")
    false_registrations: Rate = Field(
        description="Registrations more than 0.3 m off the object's place, of all."
    )
    repaired: Rate = Field(
        description="Moved objects registered within 0.3 m of their new place, of those sighted at "
        "least 5 times after."
    )
    sightings_to_remove: Spread = Field(description="From the move to the removal.")
    views_to_remove: Spread = Field(description="The same, counted by views.")
    sightings_to_register: Spread = Field(description="From the move to the registration.")
    registered_error: Spread = Field(description="How far off its place an object is put [m].")
    map_error: Mean = Field(
        description="Mean distance of live objects from their true places in the end [m]."
    )
    rms_after: Mean = Field(description="Position error after the change, rms [m].")
    p95_after: Mean = Field(description="95 % of the position errors after it, mean of runs [m].")
    lost: Mean = Field(
        description="Share of the time after it with an error of more than 1 m, or without a pose."
    )
    found: Rate = Field(description="Runs in which the robot found itself after it was carried off")
    found_s: Spread = Field(description="How long that took [s].")


def summed_up(method: Method, runs: Sequence[RunResult]) -> MethodSummary:
    """The figures of one method in all runs."""
    pairs = [pair for run in runs for pair in run.pairs if pair.method == method.name]
    moves = [move for pair in pairs for move in pair.moves]
    seen = [move for move in moves if move.sightings >= ENOUGH_SIGHTINGS]
    viewed = [move for move in moves if move.views >= ENOUGH_SIGHTINGS]
    removals = sum(pair.removals for pair in pairs)
    wrong = sum(len(pair.false_removals) for pair in pairs)
    carried = [
        pair
        for run in runs
        for pair in run.pairs
        if pair.method == method.name and run.carried_at is not None
    ]
    found = [pair.found_s for pair in carried if pair.found_s is not None]
    return MethodSummary(
        method=method.name,
        title=method.title,
        runs=len(pairs),
        moved=len(moves),
        recall=rate_of(sum(move.noticed for move in seen), len(seen)),
        recall_by_views=rate_of(sum(move.noticed for move in viewed), len(viewed)),
        precision=rate_of(removals - wrong, removals),
        false_removals=rate_of(wrong, sum(run.sightings for run in runs)),
        false_registrations=rate_of(
            sum(len(pair.false_registrations) for pair in pairs),
            sum(pair.registrations for pair in pairs),
        ),
        repaired=rate_of(sum(map(_repaired, seen)), len(seen)),
        sightings_to_remove=_spread(move.sightings_to_remove for move in seen),
        views_to_remove=_spread(move.views_to_remove for move in seen),
        sightings_to_register=_spread(move.sightings_to_register for move in seen),
        registered_error=_spread(move.registered_error for move in seen),
        map_error=mean_of([_or_nan(pair.map_error) for pair in pairs]),
        rms_after=root_mean_square_of([_or_nan(pair.rms_after) for pair in pairs]),
        p95_after=mean_of([_or_nan(pair.p95_after) for pair in pairs]),
        lost=mean_of([pair.lost_after for pair in pairs]),
        found=rate_of(len(found), len(carried)),
        found_s=_spread(found),
    )


@dataclass(frozen=True)
class _Measure:
    """What methods are compared by: a rate `of` their summaries, told `per` so many."""

    title: str
    per: int
    more_is_better: bool
    of: Callable[[MethodSummary], Rate]

    def better(self, other: MethodSummary, ours: MethodSummary) -> bool:
        """Whether another method's rate is better; not if one of them is not known."""
        one, its = self.of(ours).rate, self.of(other).rate
        return (
            one is not None
            and its is not None
            and (its > one if self.more_is_better else its < one)
        )

    def told(self, other: MethodSummary, ours: MethodSummary) -> str:
        """That it is better in this, with the figures, and whether they can tell."""
        its, one = (f"{self.per * (self.of(method).rate or 0.0):.2f}" for method in (other, ours))
        if ours.runs < LEAST_CASES:
            doubt = f"; {_too_few(ours)}"
        else:
            doubt = "; the intervals overlap" if _overlap(self.of(ours), self.of(other)) else ""
        unit = "" if self.per == 1 else f" of {self.per} sightings"
        return f"in {self.title}{unit} ({its} against {one}{doubt})"


_RECALL = _Measure("recall", 1, True, lambda one: one.recall)
_FALSE_REMOVALS = _Measure("false removals", 1000, False, lambda one: one.false_removals)


def better_elsewhere(ours: MethodSummary, others: Sequence[MethodSummary]) -> Iterator[str]:
    """In words, which other methods are better than ours in recall or in false removals.

    And what these runs cannot tell.
    """
    measures = [_RECALL, _FALSE_REMOVALS]
    for other in others:
        parts = [one.told(other, ours) for one in measures if one.better(other, ours)]
        if parts:
            both = "both " if len(parts) == len(measures) else ""
            nothing = ", as it removes nothing at all" if other.precision.of == 0 else ""
            who = other.title.capitalize()
            yield f"{who} is better than ours {both}{' and '.join(parts)}{nothing}."
    if ours.recall.of < LEAST_CASES:
        yield f"Recall cannot be compared: {_too_few_moved(ours)}."
        measures.remove(_RECALL)
    if ours.runs < LEAST_CASES:
        yield f"{_too_few(ours)} which method is better: at least {LEAST_CASES} are needed."
        return
    for measure in measures:
        yield from _unbeaten(measure, ours, others)


def _unbeaten(
    measure: _Measure, ours: MethodSummary, others: Sequence[MethodSummary]
) -> Iterator[str]:
    """That no other method is better in this, and of which that is not certain."""
    if any(measure.better(other, ours) for other in others):
        return
    alike = [one.title for one in others if _overlap(measure.of(ours), measure.of(one))]
    doubt = f"; the intervals of {text.enumerated(alike)} overlap with its" if alike else ""
    yield (
        f"No other method is better than ours in {measure.title} in these {ours.runs} runs{doubt}."
    )


def _too_few_moved(summary: MethodSummary) -> str:
    if not summary.moved:
        return "no object was moved"
    return (
        f"of {text.count(summary.moved, 'moved object')} {summary.recall.of or 'none'} "
        f"{'were' if summary.recall.of > 1 else 'was'} sighted {ENOUGH_SIGHTINGS} times after, and "
        f"at least {LEAST_CASES} are needed"
    )


def _too_few(summary: MethodSummary) -> str:
    return f"{text.count(summary.runs, 'run')} cannot tell"


def _repaired(move: MoveResult) -> bool:
    return move.registered_error is not None and move.registered_error <= THERE_M


def _overlap(one: Rate, other: Rate) -> bool:
    if one.low is None or one.high is None or other.low is None or other.high is None:
        return True
    return one.low <= other.high and other.low <= one.high


def _spread(values: Iterable[float | None]) -> Spread:
    return spread_of([value for value in values if value is not None])


def _or_nan(value: float | None) -> float:
    return _NAN if value is None else value
