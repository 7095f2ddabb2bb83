"""Results of an evaluation: the summary of many runs, its report and its pictures."""

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from cairn import SECOND, CairnError
from cairn.planar.grid import Frame, Grid
from cairn_lab.batch.options import seeds_of
from cairn_lab.evaluation.examiner import Attempt
from cairn_lab.evaluation.report import draw_paths, draw_tracks, report_lines
from cairn_lab.evaluation.results import (
    GoalResult,
    LocalizationQuality,
    RunResult,
    summarize,
)


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


def test_time_of_doubt_is_added_and_the_longest_wrong_belief_counts() -> None:
    attempt = Attempt((0.0, 0.0, 0.0), 0, 1.0)
    beliefs = [(True, True), (False, True), (False, False), (True, False), (True, False),
               (True, True), (True, False), (True, True)]  # fmt: skip
    for second, (sure, near) in enumerate(beliefs, start=1):
        attempt.judge_belief(second * SECOND, sure=sure, near=near)

    assert attempt.unsure_ns == 2 * SECOND
    assert attempt.misled_ns == 1 * SECOND


def test_summary_adds_goals_paths_and_collisions_of_all_runs() -> None:
    summary = summarize(
        [
            run(goal(True, 4.0, 4.4), goal(False, 4.0, 9.0)),
            run(goal(True, 2.0, 2.6), goal(True, 1.0, 8.0, kidnapped=True), collisions=2),
        ],
        {},
    )

    assert (summary.goals, summary.reached, summary.collisions) == (4, 3, 2)
    assert (summary.kidnapped, summary.kidnapped_reached) == (1, 1)
    assert summary.path_ratio_mean == pytest.approx((1.1 + 1.3) / 2)  # without the kidnapped one
    assert summary.recoveries == 4
    assert summary.within == (0.6, 0.9, 1.0)


def run_with_error(error_m: float, poses: int, within: tuple[float, float, float]) -> RunResult:
    counts = {round(error_m * 1e4): poses}
    return run(goal(True, 4.0, 4.4)).model_copy(update={"error_counts": counts, "within": within})


def test_summary_weighs_errors_by_the_number_of_poses() -> None:
    good = [run_with_error(0.004, 100, (1.0, 1.0, 1.0))] * 9
    bad = run_with_error(3.0, 300, (0.0, 0.0, 0.2))

    summary = summarize([*good, bad], {})

    assert summary.error_median == pytest.approx(0.004)
    assert summary.error_p95 == pytest.approx(3.0)  # 300 of 1200 poses had this error
    assert summary.within == (0.75, 0.75, 0.8)


def test_end_errors_are_those_of_goals_with_reported_success() -> None:
    silent = goal(False, 4.0, 1.0).model_copy(update={"claimed": False, "end_error": 5.0})

    summary = summarize([run(goal(True, 4.0, 4.4), goal(False, 4.0, 4.4), silent)], {})

    assert summary.end_error_median == pytest.approx(0.11)
    assert summary.end_turn_p95 == pytest.approx(0.01)


def test_report_names_failures_and_what_errors_leave_out() -> None:
    lost = goal(True, 4.0, 4.4, kidnapped=True).model_copy(update={"relocalized_s": None})
    runs = [
        run(goal(False, 4.0, 4.4), goal(True, 1.0, 8.0, kidnapped=True), lost, collisions=1),
        RunResult(seed=2, failure="never kidnapped"),
    ]

    text = "\n".join(report_lines("hall.yaml", runs, summarize(runs, {})))

    assert "seed 1, goal 1 at (0.00, 0.00) not reached: " in text
    assert "seed 1, collision: table at (1.00, 1.00), 0.20 m/s" in text
    assert "seed 2 failed: never kidnapped" in text
    assert "failed            1 of 2 runs" in text
    assert "relocalized       1 of 2, 2.0 s median, 2.0 s maximum" in text
    assert "without the time from kidnapping to relocalization" in text


def test_report_names_events_that_a_valid_run_missed() -> None:
    failed = RunResult(seed=2, failure="never kidnapped")

    for at, expected in ((100.0, ""), (101.0, "0 of 1 came due in every valid run; ")):
        summary = summarize([run(), failed], {"kidnap": at})
        lines = [line for line in report_lines("hall.yaml", [], summary) if "events" in line]
        assert lines == ([f'  events            {expected}"kidnap" in none'] if expected else [])


def test_summary_without_reached_goals_has_no_path_ratio() -> None:
    summary = summarize([run(goal(False, 4.0, 1.0))], {})

    assert summary.reached_share == 0.0
    assert summary.path_ratio_mean is None


def test_correct_covariance_contains_the_truth_as_often_as_a_gaussian() -> None:
    quality = LocalizationQuality()
    random = np.random.default_rng(0)
    for _ in range(4000):
        x, y = random.normal(0.0, 0.05, 2)
        quality.add((x, y, 0.0), np.diag([0.05**2, 0.05**2, 0.01]), (0.0, 0.0, 0.0))

    assert quality.within() == pytest.approx((0.683, 0.954, 0.997), abs=0.03)
    assert quality.percentile(50) == pytest.approx(0.05 * math.sqrt(2 * math.log(2)), rel=0.05)


def test_invalid_covariance_never_contains_the_truth() -> None:
    quality = LocalizationQuality()
    for covariance in (np.zeros((3, 3)), np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, 0.0, 1.0])):
        quality.add((0.0, 0.0, 0.0), covariance, (5.0, 5.0, 0.0))
    quality.add((0.0, 0.0, 0.0), np.eye(3), (0.1, 0.0, 0.0))

    assert quality.within() == (0.25, 0.25, 0.25)


def test_seeds_are_a_range() -> None:
    assert list(seeds_of("3..5")) == [3, 4, 5]
    assert list(seeds_of("7")) == [7]
    for wrong in ("a..b", "5..3", "-1..2", ""):
        with pytest.raises(CairnError, match="--seeds"):
            seeds_of(wrong)


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are saved."""
    saved: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: saved.append(self))
    return saved


def test_run_without_poses_has_no_error_in_the_picture(figures: list[Figure]) -> None:
    runs = [RunResult(seed=0, error_median=0.01, error_p95=0.02), RunResult(seed=1, failure="dead")]

    draw_paths(runs, Path("paths.png"))

    _, errors = figures[0].axes
    for line, error in zip(errors.lines, (0.01, 0.02), strict=True):
        first, second = np.asarray(line.get_ydata(), float)
        assert first == error
        assert math.isnan(second)


def test_track_is_interrupted_where_the_robot_was_kidnapped(figures: list[Figure]) -> None:
    kidnapped = RunResult(seed=0, track=[(0.1, 0.1), (0.2, 0.1), (2.0, 2.0), (2.1, 2.0)])

    draw_tracks(Grid(np.zeros((50, 50), np.int8), Frame(0.05)), [kidnapped], Path("tracks.png"))

    x = np.asarray(figures[0].axes[0].lines[0].get_xdata(), float)
    assert np.isnan(x).tolist() == [False, False, True, False, False]
