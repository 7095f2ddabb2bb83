"""The figures of an evaluation add up."""

import math

import numpy as np
import pytest

from cairn import CairnError
from cairn.cli.runs import seeds_of
from cairn.tools.evaluation.localization_quality import LocalizationQuality
from cairn.tools.evaluation.report import report_lines
from cairn.tools.evaluation.results import GoalResult, RunResult, summed_up


def goal(reached: bool, shortest: float, driven: float, kidnapped: bool = False) -> GoalResult:
    return GoalResult(
        x=0.0,
        y=0.0,
        theta=0.0,
        reached=reached,
        claimed=True,
        reason="",
        shortest=shortest,
        driven=driven,
        seconds=10.0,
        recoveries=1,
        end_error=0.02 if reached else 0.2,
        end_turn=0.01,
        kidnapped=kidnapped,
        relocalized_s=2.0 if kidnapped else None,
    )


def run(*goals: GoalResult, collisions: int = 0) -> RunResult:
    return RunResult(
        seed=1,
        goals=list(goals),
        collisions=["table at (1.00, 1.00), 0.20 m/s"] * collisions,
        error_median=0.02,
        error_p95=0.05,
        error_max=0.1,
        error_counts={200: 10},
        within=(0.6, 0.9, 1.0),
        simulated_s=100.0,
        track=[(0.0, 0.0)],
    )


def test_goals_ways_and_collisions_of_all_runs_are_summed_up() -> None:
    summary = summed_up(
        [
            run(goal(True, 4.0, 4.4), goal(False, 4.0, 9.0)),
            run(goal(True, 2.0, 2.6), goal(True, 1.0, 8.0, kidnapped=True), collisions=2),
        ],
        {},
    )

    assert (summary.goals, summary.reached, summary.collisions) == (4, 3, 2)
    assert (summary.kidnapped, summary.kidnapped_reached) == (1, 1)
    assert summary.path_ratio_mean == pytest.approx((1.1 + 1.3) / 2)  # not of who was carried off
    assert summary.recoveries == 4
    assert summary.within == (0.6, 0.9, 1.0)


def told_of(error_m: float, poses: int, within: tuple[float, float, float]) -> RunResult:
    counts = {round(error_m * 1e4): poses}
    return run(goal(True, 4.0, 4.4)).model_copy(update={"error_counts": counts, "within": within})


def test_errors_are_those_of_all_poses_of_all_runs() -> None:
    good = [told_of(0.004, 100, (1.0, 1.0, 1.0))] * 9
    bad = told_of(3.0, 300, (0.0, 0.0, 0.2))

    summary = summed_up([*good, bad], {})

    assert summary.error_median == pytest.approx(0.004)
    assert summary.error_p95 == pytest.approx(3.0)  # for 300 of 1200 poses it was that far off
    assert summary.within == (0.75, 0.75, 0.8)


def test_ends_are_of_goals_where_the_robot_said_to_be_there() -> None:
    silent = goal(False, 4.0, 1.0).model_copy(update={"claimed": False, "end_error": 5.0})

    summary = summed_up([run(goal(True, 4.0, 4.4), goal(False, 4.0, 4.4), silent)], {})

    assert summary.end_error_median == pytest.approx(0.11)
    assert summary.end_turn_p95 == pytest.approx(0.01)


def test_the_report_tells_what_went_wrong_and_what_is_left_out_of_the_errors() -> None:
    never = goal(True, 4.0, 4.4, kidnapped=True).model_copy(update={"relocalized_s": None})
    runs = [
        run(goal(False, 4.0, 4.4), goal(True, 1.0, 8.0, kidnapped=True), never, collisions=1),
        RunResult(seed=2, failure="the robot was to be carried off and never was"),
    ]

    told = "\n".join(report_lines("hall.yaml", runs, summed_up(runs, {})))

    assert "seed 1, goal 1 at (0.00, 0.00) not reached: " in told
    assert "seed 1, collision: table at (1.00, 1.00), 0.20 m/s" in told
    assert "seed 2 failed: the robot was to be carried off and never was" in told
    assert "failed            1 of 2 runs" in told
    assert "found itself      1 of 2, in 2.0 s median, 2.0 s at worst" in told
    assert "both but from being carried off until it found itself" in told


def test_events_are_told_of_only_if_a_run_that_did_not_fail_missed_them() -> None:
    failed = RunResult(seed=2, failure="the robot was to be carried off and never was")

    for at, told in ((100.0, ""), (101.0, "0 of 1 came due in every run that did not fail; ")):
        summary = summed_up([run(), failed], {"kidnap": at})
        lines = [line for line in report_lines("hall.yaml", [], summary) if "events" in line]
        assert lines == ([f'  events            {told}"kidnap" in none'] if told else [])


def test_nothing_reached_has_no_ratio() -> None:
    summary = summed_up([run(goal(False, 4.0, 1.0))], {})

    assert summary.reached_share == 0.0
    assert summary.path_ratio_mean is None


def test_an_honest_covariance_holds_the_truth_as_often_as_a_gaussian_does() -> None:
    quality = LocalizationQuality()
    random = np.random.default_rng(0)
    for _ in range(4000):
        x, y = random.normal(0.0, 0.05, 2)
        quality.add((x, y, 0.0), np.diag([0.05**2, 0.05**2, 0.01]), (0.0, 0.0, 0.0))

    assert quality.within() == pytest.approx((0.683, 0.954, 0.997), abs=0.03)
    assert quality.percentile(50) == pytest.approx(0.05 * math.sqrt(2 * math.log(2)), rel=0.05)


def test_who_states_no_error_at_all_is_never_within_it() -> None:
    quality = LocalizationQuality()
    for covariance in (np.zeros((3, 3)), np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, 0.0, 1.0])):
        quality.add((0.0, 0.0, 0.0), covariance, (5.0, 5.0, 0.0))
    quality.add((0.0, 0.0, 0.0), np.eye(3), (0.1, 0.0, 0.0))

    assert quality.within() == (0.25, 0.25, 0.25)


def test_seeds_are_given_as_a_range() -> None:
    assert list(seeds_of("3..5")) == [3, 4, 5]
    assert list(seeds_of("7")) == [7]
    for wrong in ("a..b", "5..3", "-1..2", ""):
        with pytest.raises(CairnError, match="--seeds"):
            seeds_of(wrong)
