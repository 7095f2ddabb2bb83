"""What came of the goals of one run, and the figures that many runs add up to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict


class GoalResult(BaseModel):
    """One goal: how it ended and what it took. Lengths [m], times [s], errors [m]."""

    model_config = ConfigDict(extra="forbid")

    x: float
    y: float
    reached: bool
    reason: str
    shortest: float
    driven: float
    seconds: float
    recoveries: int
    end_error: float
    kidnapped: bool = False
    relocalised_s: float | None = None


class RunResult(BaseModel):
    """One run: its goals, collisions, and how well the robot knew where it was.

    `errors` are of the position at each pose told [m]; `within` are the shares of poses whose truth
    lay within 1, 2, 3 standard deviations (of the position, two dimensions).
    """

    model_config = ConfigDict(extra="forbid")

    seed: int
    goals: list[GoalResult]
    collisions: list[str]
    error_median: float | None
    error_p95: float | None
    error_max: float | None
    within: tuple[float, float, float] | None
    simulated_s: float
    track: list[tuple[float, float]]


class Summary(BaseModel):
    """All runs of one world."""

    model_config = ConfigDict(extra="forbid")

    runs: int
    goals: int
    reached: int
    reached_share: float
    kidnapped: int
    kidnapped_reached: int
    relocalised_median_s: float | None
    collisions: int
    path_ratio_mean: float | None
    path_ratio_p95: float | None
    seconds_mean: float | None
    recoveries: int
    error_median: float | None
    error_p95: float | None
    within: tuple[float, float, float] | None
    simulated_s: float


def summed_up(runs: Sequence[RunResult]) -> Summary:
    """The figures of all runs; ways of goals at which the robot was kidnapped are left out."""
    goals = [goal for run in runs for goal in run.goals]
    plain = [g for g in goals if g.reached and not g.kidnapped and g.shortest > 0]
    ratios = [g.driven / g.shortest for g in plain]
    kidnapped = [g for g in goals if g.kidnapped]
    found = [g.relocalised_s for g in kidnapped if g.relocalised_s is not None]
    medians = [run.error_median for run in runs if run.error_median is not None]
    p95s = [run.error_p95 for run in runs if run.error_p95 is not None]
    within = np.array([run.within for run in runs if run.within is not None])
    reached = sum(goal.reached for goal in goals)
    return Summary(
        runs=len(runs),
        goals=len(goals),
        reached=reached,
        reached_share=reached / len(goals) if goals else 0.0,
        kidnapped=len(kidnapped),
        kidnapped_reached=sum(goal.reached for goal in kidnapped),
        relocalised_median_s=float(np.median(found)) if found else None,
        collisions=sum(len(run.collisions) for run in runs),
        path_ratio_mean=float(np.mean(ratios)) if ratios else None,
        path_ratio_p95=float(np.percentile(ratios, 95)) if ratios else None,
        seconds_mean=float(np.mean([g.seconds for g in plain])) if plain else None,
        recoveries=sum(goal.recoveries for goal in goals),
        error_median=float(np.median(medians)) if medians else None,
        error_p95=float(np.median(p95s)) if p95s else None,
        within=_triple(within.mean(axis=0)) if len(within) else None,
        simulated_s=sum(run.simulated_s for run in runs),
    )


def _triple(
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> tuple[float, float, float]:
    one, two, three = (round(float(value), 4) for value in values)
    return one, two, three
