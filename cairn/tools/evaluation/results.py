"""What came of the goals of one run, and the figures that many runs add up to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

# Fineness of the errors that are kept [m].
ERROR_STEP_M = 1e-4
_ERRORS = (
    "of the position of all poses told [m], but not of a robot that was carried off until it has "
    "found itself (0.5 m, 0.5 rad) or its goal is over"
)


class GoalResult(BaseModel):
    """One goal: how it ended and what it took."""

    model_config = ConfigDict(extra="forbid")

    x: float = Field(description="Of the goal [m].")
    y: float = Field(description="Of the goal [m].")
    theta: float = Field(description="Of the goal [rad].")
    reached: bool = Field(description="Said to be there, and truly there in place and heading.")
    claimed: bool = Field(description="The robot said to be there.")
    reason: str = Field(description="Why it ended.")
    shortest: float = Field(description="The shortest way in the world as it stood then [m].")
    driven: float = Field(description="The way truly taken [m].")
    seconds: float = Field(description="From the order to its end [s].")
    recoveries: int = Field(description="How often the robot recovered [1].")
    end_error: float = Field(description="How far from the goal the robot truly was [m].")
    end_turn: float = Field(description="How far it was truly turned from the goal [rad].")
    kidnapped: bool = Field(False, description="It was carried off on the way, as the truth shows.")
    relocalized_s: float | None = Field(
        None, description="How long it took to find itself after that [s]; null: it did not."
    )


class RunResult(BaseModel):
    """One run: its goals, collisions, and how well the robot knew where it was."""

    model_config = ConfigDict(extra="forbid")

    seed: int
    failure: str = Field("", description="Why the run counts for nothing; empty if it does count.")
    goals: list[GoalResult] = Field(default_factory=list)
    collisions: list[str] = Field(default_factory=list)
    error_median: float | None = Field(None, description=f"Median {_ERRORS}.")
    error_p95: float | None = Field(None, description=f"95 % {_ERRORS}.")
    error_max: float | None = Field(None, description=f"Largest {_ERRORS}.")
    error_counts: dict[int, int] = Field(
        default_factory=dict, description="How many poses had an error of so many 0.1 mm."
    )
    within: tuple[float, float, float] | None = Field(
        None,
        description="Shares of these poses whose truth lay within 1, 2, 3 of the stated standard "
        "deviations (68, 95, 99.7 % of a Gaussian of the position).",
    )
    simulated_s: float = 0.0
    track: list[tuple[float, float]] = Field(default_factory=list, description="True way [m].")


class Summary(BaseModel):
    """All runs of one world."""

    model_config = ConfigDict(extra="forbid")

    runs: int
    failed: int = Field(description="Runs that failed, or that did not do what was asked.")
    failures: dict[int, str] = Field(description="Why each of these failed, by its seed.")
    events: dict[str, int] = Field(
        description="In how many of the runs that did not fail each scripted event of the world "
        "came due before the end."
    )
    goals: int
    reached: int
    reached_share: float
    kidnapped: int = Field(description="Goals on the way to which the robot was carried off.")
    kidnapped_reached: int
    relocalized: int = Field(description="How often it found itself after that.")
    relocalized_median_s: float | None
    relocalized_worst_s: float | None
    collisions: int
    path_ratio_mean: float | None = Field(
        description="Way driven over the shortest, of goals reached without being carried off."
    )
    path_ratio_p95: float | None
    seconds_mean: float | None = Field(description="Time for each of these [s].")
    recoveries: int
    end_error_median: float | None = Field(
        description="True distance to the goal where the robot said to be there [m]."
    )
    end_error_p95: float | None
    end_turn_median: float | None = Field(description="The same of the heading [rad].")
    end_turn_p95: float | None
    error_median: float | None = Field(description=f"Median over all runs {_ERRORS}.")
    error_p95: float | None = Field(description=f"95 % over all runs {_ERRORS}.")
    within: tuple[float, float, float] | None = Field(
        description="Shares of these poses whose truth lay within 1, 2, 3 of the stated sigma."
    )
    simulated_s: float


def summed_up(runs: Sequence[RunResult], events: Mapping[str, float]) -> Summary:
    """The figures of all runs; `events` says when [s] each scripted event of the world comes due.

    Ways of goals at which the robot was kidnapped are left out.
    """
    durations = [run.simulated_s for run in runs if not run.failure]
    goals = [goal for run in runs for goal in run.goals]
    plain = [g for g in goals if g.reached and not g.kidnapped and g.shortest > 0]
    ratios = [g.driven / g.shortest for g in plain]
    kidnapped = [g for g in goals if g.kidnapped]
    found = [g.relocalized_s for g in kidnapped if g.relocalized_s is not None]
    ends = [g for g in goals if g.claimed]
    errors = pooled_errors(runs)
    reached = sum(goal.reached for goal in goals)
    return Summary(
        runs=len(runs),
        failed=sum(bool(run.failure) for run in runs),
        failures={run.seed: run.failure for run in runs if run.failure},
        events={
            event: sum(duration >= at for duration in durations) for event, at in events.items()
        },
        goals=len(goals),
        reached=reached,
        reached_share=reached / len(goals) if goals else 0.0,
        kidnapped=len(kidnapped),
        kidnapped_reached=sum(goal.reached for goal in kidnapped),
        relocalized=len(found),
        relocalized_median_s=_percentile(found, 50),
        relocalized_worst_s=max(found, default=None),
        collisions=sum(len(run.collisions) for run in runs),
        path_ratio_mean=float(np.mean(ratios)) if ratios else None,
        path_ratio_p95=_percentile(ratios, 95),
        seconds_mean=float(np.mean([g.seconds for g in plain])) if plain else None,
        recoveries=sum(goal.recoveries for goal in goals),
        end_error_median=_percentile([g.end_error for g in ends], 50),
        end_error_p95=_percentile([g.end_error for g in ends], 95),
        end_turn_median=_percentile([g.end_turn for g in ends], 50),
        end_turn_p95=_percentile([g.end_turn for g in ends], 95),
        error_median=_percentile(errors, 50),
        error_p95=_percentile(errors, 95),
        within=_within(runs),
        simulated_s=sum(run.simulated_s for run in runs),
    )


def pooled_errors(runs: Sequence[RunResult]) -> NDArray[np.float64]:
    """The errors [m] of the poses of all runs: a long run weighs more than a short one."""
    steps = [step for run in runs for step in run.error_counts]
    counts = [count for run in runs for count in run.error_counts.values()]
    return np.repeat(np.array(steps, np.float64) * ERROR_STEP_M, np.array(counts, np.int64))


def _within(runs: Sequence[RunResult]) -> tuple[float, float, float] | None:
    told = [(run.within, sum(run.error_counts.values())) for run in runs if run.within is not None]
    poses = sum(count for _, count in told)
    if not poses:
        return None
    one, two, three = (
        round(sum(shares[sigma] * count for shares, count in told) / poses, 4) for sigma in range(3)
    )
    return one, two, three


def _percentile(values: Sequence[float] | NDArray[np.float64], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None
