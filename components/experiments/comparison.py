"""Many runs of several methods, summed up, and in words where another is better than ours."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from pydantic import BaseModel, ConfigDict, Field

from components.experiments.judging import THERE_M, MoveResult, RunResult
from components.experiments.methods import Method
from components.experiments.statistics import (
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


def better_elsewhere(ours: MethodSummary, others: Sequence[MethodSummary]) -> Iterator[str]:
    """In words, which other methods are better than ours in recall or in false removals."""
    told = False
    for other in others:
        finds = _by(ours.recall, other.recall) > 0
        spares = _by(ours.false_removals, other.false_removals) < 0
        if not finds and not spares:
            continue
        told = True
        parts = []
        if finds:
            parts.append(
                f"in recall ({_told(other.recall)} against {_told(ours.recall)}"
                f"{_doubt(ours.recall, other.recall)})"
            )
        if spares:
            parts.append(
                "in false removals of 1000 sightings ("
                f"{_told(other.false_removals, 1000)} against {_told(ours.false_removals, 1000)}"
                f"{_doubt(ours.false_removals, other.false_removals)})"
            )
        both = "both " if finds and spares else ""
        nothing = ", as it removes nothing at all" if other.precision.of == 0 else ""
        who = other.title.capitalize()
        yield f"{who} is better than ours {both}{' and '.join(parts)}{nothing}."
    if not told:
        yield "No other method is better than ours, neither in recall nor in false removals."


def _repaired(move: MoveResult) -> bool:
    return move.registered_error is not None and move.registered_error <= THERE_M


def _by(ours: Rate, other: Rate) -> float:
    """How much larger the other rate is; 0 where one is not known."""
    return 0.0 if ours.rate is None or other.rate is None else other.rate - ours.rate


def _told(value: Rate, per: int = 1) -> str:
    return "-" if value.rate is None else f"{per * value.rate:.2f}"


def _doubt(one: Rate, other: Rate) -> str:
    apart = (
        one.low is not None
        and one.high is not None
        and other.low is not None
        and other.high is not None
        and (one.low > other.high or other.low > one.high)
    )
    return "" if apart else "; the intervals overlap"


def _spread(values: Iterable[float | None]) -> Spread:
    return spread_of([value for value in values if value is not None])


def _or_nan(value: float | None) -> float:
    return _NAN if value is None else value
