"""Methods are summarized over runs, and the report names each method that is better than ours."""

from __future__ import annotations

import pytest

from cairn_lab.experiments.ablation import MethodSummary, compare_with_ours, summarize_method
from cairn_lab.experiments.methods import CHI_SQUARE, NO_UPDATE, OURS, Method
from cairn_lab.experiments.results import ExperimentRunResult, MethodResult, MoveResult
from tests.wording import assert_words


def move(noticed: bool, observations: int = 9, error: float | None = None) -> MoveResult:
    return MoveResult(
        object_id=1,
        moved_at=10.0,
        distance=2.0,
        neighbor_distance=1.0,
        observations=observations,
        viewpoints=4,
        noticed=noticed,
        removed_at=12.0 if noticed else None,
        observations_to_remove=3 if noticed else None,
        viewpoints_to_remove=2 if noticed else None,
        registered_at=None if error is None else 14.0,
        observations_to_register=None if error is None else 5,
        registration_error=error,
    )


def result(method: Method, *moves: MoveResult, removals: int = 0, false: int = 0) -> MethodResult:
    return MethodResult(
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


def runs(*methods: MethodResult, count: int = 1) -> list[ExperimentRunResult]:
    return [
        ExperimentRunResult(seed=n, observations=500, methods=list(methods)) for n in range(count)
    ]


def sentences(*methods: MethodResult, count: int = 1) -> list[str]:
    done = runs(*methods, count=count)
    ours, *others = (summarize_method(m, done) for m in (OURS, CHI_SQUARE, NO_UPDATE))
    return list(compare_with_ours(ours, others))


def test_only_objects_observed_five_times_after_the_move_count() -> None:
    ours = result(OURS, move(True, 5, 0.1), move(False, 6), move(False, 4), removals=1)

    summary = summarize_method(OURS, runs(ours, count=2))

    assert isinstance(summary, MethodSummary)
    assert (summary.recall.count, summary.recall.of) == (2, 4)
    assert (summary.repaired.count, summary.repaired.of) == (2, 4)
    assert summary.recall_by_viewpoints.of == 0
    assert summary.observations_to_remove.median == 3.0


def test_false_removals_are_counted_by_removals_and_by_observations() -> None:
    summary = summarize_method(OURS, runs(result(OURS, removals=4, false=1), count=3))

    assert summary.precision.rate == pytest.approx(0.75)
    assert summary.false_removals.rate == pytest.approx(3 / 1500)


def test_better_methods_are_named_with_their_figures() -> None:
    ours = result(OURS, move(True), move(False), removals=2, false=1)
    other = result(CHI_SQUARE, move(True), move(True), removals=4, false=2)
    none = result(NO_UPDATE, move(False), move(False))

    chi_square, no_update = sentences(ours, other, none, count=100)

    assert chi_square.startswith("Chi-square gate is better than ours in recall (1.00 against 0.50")
    assert "overlap" not in chi_square
    assert no_update.startswith("No update is better than ours in false removals")
    assert "(0.00 against 2.00)" in no_update
    assert no_update.endswith("as it removes nothing at all.")


def test_uncertain_difference_is_marked() -> None:
    better, removals = sentences(
        result(OURS, move(True), move(False)),
        result(CHI_SQUARE, move(True), move(True), removals=2),
        result(NO_UPDATE, move(False), move(False)),
        count=5,
    )

    assert better.startswith("Chi-square gate is better than ours in recall (1.00 against 0.50; ")
    assert "the intervals overlap" in better
    assert_words(
        removals,
        "No other method is better",
        "false removals",
        "5 runs",
        "chi-square gate and no update",
        "overlap",
    )


def test_report_states_that_no_method_is_better() -> None:
    recall, removals = sentences(
        result(OURS, move(True)),
        result(CHI_SQUARE, move(True), false=1, removals=2),
        result(NO_UPDATE, move(False)),
        count=100,
    )

    assert_words(
        recall, "No other method is better", "recall", "100 runs", "chi-square gate overlap"
    )
    assert removals.endswith("100 runs; the intervals of no update overlap with ours.")


def test_single_run_does_not_decide_which_method_is_better() -> None:
    better, recall, note = sentences(
        result(OURS, move(True), move(False, observations=3), removals=60, false=59),
        result(CHI_SQUARE, move(True), move(False, observations=3), removals=60, false=59),
        result(NO_UPDATE, move(False), move(False, observations=3)),
    )

    assert better.startswith("No update is better than ours in false removals")
    assert "(0.00 against 118.00; 1 run: too few" in better
    assert recall.startswith("Recall cannot be compared: 1 of 2 moved objects observed at least 5")
    assert note.startswith("1 run: too few to decide which method is better; at least 4")


def test_without_moved_objects_recall_is_not_compared() -> None:
    recall, removals = sentences(result(OURS), result(CHI_SQUARE), result(NO_UPDATE), count=30)

    assert_words(recall, "Recall cannot be compared", "no object was moved")
    assert removals.startswith("No other method is better than ours in false removals")
