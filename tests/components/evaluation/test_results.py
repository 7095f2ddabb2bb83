"""The figures of an evaluation add up."""

import math

import numpy as np
import pytest

from cairn.errors import CairnError
from components.evaluation.cli import _seeds
from components.evaluation.free_goals import FreeGoals
from components.evaluation.localization_quality import LocalizationQuality
from components.evaluation.results import GoalResult, RunResult, summed_up
from tests.components.localizer.room import room


def goal(reached: bool, shortest: float, driven: float, kidnapped: bool = False) -> GoalResult:
    return GoalResult(
        x=0.0,
        y=0.0,
        reached=reached,
        reason="",
        shortest=shortest,
        driven=driven,
        seconds=10.0,
        recoveries=1,
        end_error=0.0,
        kidnapped=kidnapped,
        relocalised_s=2.0 if kidnapped else None,
    )


def run(*goals: GoalResult, collisions: int = 0) -> RunResult:
    return RunResult(
        seed=1,
        goals=list(goals),
        collisions=["table at (1.00, 1.00), 0.20 m/s"] * collisions,
        error_median=0.02,
        error_p95=0.05,
        error_max=0.1,
        within=(0.6, 0.9, 1.0),
        simulated_s=100.0,
        track=[(0.0, 0.0)],
    )


def test_goals_ways_and_collisions_of_all_runs_are_summed_up() -> None:
    summary = summed_up(
        [
            run(goal(True, 4.0, 4.4), goal(False, 4.0, 9.0)),
            run(goal(True, 2.0, 2.6), goal(True, 1.0, 8.0, kidnapped=True), collisions=2),
        ]
    )

    assert (summary.goals, summary.reached, summary.collisions) == (4, 3, 2)
    assert (summary.kidnapped, summary.kidnapped_reached) == (1, 1)
    assert summary.path_ratio_mean == pytest.approx((1.1 + 1.3) / 2)  # not of who was carried off
    assert summary.recoveries == 4
    assert summary.within == (0.6, 0.9, 1.0)


def test_nothing_reached_has_no_ratio() -> None:
    summary = summed_up([run(goal(False, 4.0, 1.0))])

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


def test_goals_are_drawn_where_the_robot_can_stand_and_ways_to_them_are_shortest() -> None:
    free = FreeGoals(room(), 0.22, 0.15)
    random = np.random.default_rng(1)
    start = (2.0, 2.0, 0.0)

    goals = [free.draw(start, 1.5, random) for _ in range(50)]

    for drawn in goals:
        assert drawn is not None
        straight = math.dist(drawn[:2], start[:2])
        assert straight >= 1.5
        assert 0.97 * straight <= free.shortest(start, drawn) < 3.0 * straight
    assert free.shortest(start, (4.75, 3.3, 0.0)) == math.inf  # in the middle of a box


def test_seeds_are_given_as_a_range() -> None:
    assert list(_seeds("3..5")) == [3, 4, 5]
    assert list(_seeds("7")) == [7]
    for wrong in ("a..b", "5..3", "-1..2", ""):
        with pytest.raises(CairnError, match="--seeds"):
            _seeds(wrong)
