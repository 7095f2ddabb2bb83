"""Methods are summed up over runs, and where another is better the report says so."""

from __future__ import annotations

import pytest

from cairn.tools.experiments.comparison import MethodSummary, better_elsewhere, summed_up
from cairn.tools.experiments.judging import MoveResult, PairResult, RunResult
from cairn.tools.experiments.methods import CHI_SQUARE, NO_UPDATE, OURS, Method


def move(noticed: bool, sightings: int = 9, error: float | None = None) -> MoveResult:
    return MoveResult(
        object_id=1,
        moved_at=10.0,
        way=2.0,
        beside=1.0,
        sightings=sightings,
        views=4,
        noticed=noticed,
        removed_at=12.0 if noticed else None,
        sightings_to_remove=3 if noticed else None,
        views_to_remove=2 if noticed else None,
        registered_at=None if error is None else 14.0,
        sightings_to_register=None if error is None else 5,
        registered_error=error,
    )


def made(method: Method, *moves: MoveResult, removals: int = 0, false: int = 0) -> PairResult:
    return PairResult(
        method=method.name,
        moves=list(moves),
        removals=removals,
        false_removals=["object 2"] * false,
        registrations=0,
        false_registrations=[],
        restored=0,
        map_error=0.1,
        missing=[],
        rms_before=0.01,
        rms_after=0.03,
        p95_after=0.05,
        lost_after=0.0,
    )


def runs(*pairs: PairResult, count: int = 1) -> list[RunResult]:
    return [RunResult(seed=n, sightings=500, pairs=list(pairs)) for n in range(count)]


def words(*pairs: PairResult, count: int = 1) -> list[str]:
    done = runs(*pairs, count=count)
    ours, *others = (summed_up(m, done) for m in (OURS, CHI_SQUARE, NO_UPDATE))
    return list(better_elsewhere(ours, others))


def test_only_who_was_sighted_five_times_after_the_move_is_asked_for() -> None:
    pair = made(OURS, move(True, 5, 0.1), move(False, 6), move(False, 4), removals=1)

    summary = summed_up(OURS, runs(pair, count=2))

    assert isinstance(summary, MethodSummary)
    assert (summary.recall.count, summary.recall.of) == (2, 4)
    assert (summary.repaired.count, summary.repaired.of) == (2, 4)
    assert summary.recall_by_views.of == 0
    assert summary.sightings_to_remove.median == 3.0


def test_false_removals_are_told_by_sightings_and_by_removals() -> None:
    summary = summed_up(OURS, runs(made(OURS, removals=4, false=1), count=3))

    assert summary.precision.rate == pytest.approx(0.75)
    assert summary.false_removals.rate == pytest.approx(3 / 1500)


def test_who_is_better_than_ours_is_named_with_the_figures() -> None:
    one = made(OURS, move(True), move(False), removals=2, false=1)
    other = made(CHI_SQUARE, move(True), move(True), removals=4, false=2)
    none = made(NO_UPDATE, move(False), move(False))

    chi_square, no_update = words(one, other, none, count=100)  # and not that nobody is better

    assert chi_square.startswith("Chi-square gate is better than ours in recall (1.00 against 0.50")
    assert "overlap" not in chi_square
    assert no_update.startswith("No update is better than ours in false removals")
    assert "(0.00 against 2.00)" in no_update
    assert no_update.endswith("as it removes nothing at all.")


def test_a_difference_that_few_runs_cannot_tell_is_told_as_such() -> None:
    better, removals = words(
        made(OURS, move(True), move(False)),
        made(CHI_SQUARE, move(True), move(True), removals=2),
        made(NO_UPDATE, move(False), move(False)),
        count=5,
    )

    assert better.startswith("Chi-square gate is better than ours in recall (1.00 against 0.50; ")
    assert "the intervals overlap" in better
    assert removals == (
        "No other method is better than ours in false removals in these 5 runs; the intervals of "
        "chi-square gate and no update overlap with its."
    )


def test_where_nobody_is_better_that_is_told() -> None:
    recall, removals = words(
        made(OURS, move(True)),
        made(CHI_SQUARE, move(True), false=1, removals=2),
        made(NO_UPDATE, move(False)),
        count=100,
    )

    assert recall == (
        "No other method is better than ours in recall in these 100 runs; the intervals of "
        "chi-square gate overlap with its."
    )
    assert removals.endswith("100 runs; the intervals of no update overlap with its.")


def test_a_single_run_cannot_tell_who_is_better() -> None:
    better, recall, told = words(
        made(OURS, move(True), move(False, sightings=3), removals=60, false=59),
        made(CHI_SQUARE, move(True), move(False, sightings=3), removals=60, false=59),
        made(NO_UPDATE, move(False), move(False, sightings=3)),
    )

    assert better.startswith("No update is better than ours in false removals")
    assert "(0.00 against 118.00; 1 run cannot tell)" in better
    assert recall == (
        "Recall cannot be compared: of 2 moved objects 1 was sighted 5 times after, and at least 4 "
        "are needed."
    )
    assert told == "1 run cannot tell which method is better: at least 4 are needed."


def test_where_nothing_was_moved_nobody_is_said_to_be_no_better_in_recall() -> None:
    recall, removals = words(made(OURS), made(CHI_SQUARE), made(NO_UPDATE), count=30)

    assert recall == "Recall cannot be compared: no object was moved."
    assert removals.startswith("No other method is better than ours in false removals")
