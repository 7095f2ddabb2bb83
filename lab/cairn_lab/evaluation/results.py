"""Results of one goal, one run and all runs of an evaluation, and how they are computed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cairn.components.localizer.pose_health import SURE_HEALTH
from cairn.planar.poses import Pose

SIGMA_LIMITS = tuple(-2.0 * math.log(math.erfc(k / math.sqrt(2.0))) for k in (1, 2, 3))
"""Normalized squared errors of a position within 1, 2, 3 sigma: 2.30, 6.18, 11.83.

The quantiles of chi-square with 2 degrees of freedom at 68.3, 95.4 and 99.7 %.
"""

ERROR_STEP_M = 1e-4
"""Resolution of the position errors that are kept [m]."""

_ERRORS = (
    "of the position error of all estimated poses [m], except of a kidnapped robot until it is "
    "relocalized (within 0.5 m and 0.5 rad) or its goal ends"
)


class GoalResult(BaseModel):
    """One goal: how it ended and what it took."""

    model_config = ConfigDict(extra="forbid")

    x: float = Field(description="Goal [m].")
    y: float = Field(description="Goal [m].")
    theta: float = Field(description="Goal [rad].")
    reached: bool = Field(
        description="The robot reported success, and its true position and heading were right."
    )
    claimed: bool = Field(description="The robot reported success.")
    reason: str = Field(description="Why the goal ended.")
    shortest: float = Field(
        description="Length of the shortest path in the world as it was at that time [m]."
    )
    driven: float = Field(description="Length of the true path [m].")
    seconds: float = Field(description="Time from the request to its end [s].")
    recoveries: int = Field(description="Number of recovery behaviors [1].")
    end_error: float = Field(description="True distance from the goal at the end [m].")
    end_turn: float = Field(description="True heading error at the end [rad].")
    kidnapped: bool = Field(
        False, description="The robot was kidnapped on the way, according to the ground truth."
    )
    relocalized_s: float | None = Field(
        None, description="Time from then until it was relocalized [s]; null: it was not."
    )
    unsure_s: float = Field(0.0, description=f"Time with a health below {SURE_HEALTH} [s].")
    misled_s: float = Field(
        0.0,
        description=f"Longest time with a health of at least {SURE_HEALTH} while the robot was not "
        "within 0.5 m and 0.5 rad of its estimate [s].",
    )


class RunResult(BaseModel):
    """One run: its goals, its collisions, and the quality of localization."""

    model_config = ConfigDict(extra="forbid")

    seed: int
    failure: str = Field("", description="Why the run is not valid; empty if it is.")
    goals: list[GoalResult] = Field(default_factory=list)
    collisions: list[str] = Field(default_factory=list)
    error_median: float | None = Field(None, description=f"Median {_ERRORS}.")
    error_p95: float | None = Field(None, description=f"95th percentile {_ERRORS}.")
    error_max: float | None = Field(None, description=f"Maximum {_ERRORS}.")
    error_counts: dict[int, int] = Field(
        default_factory=dict, description="Number of poses by their error in steps of 0.1 mm."
    )
    within: tuple[float, float, float] | None = Field(
        None,
        description="Fractions of these poses whose true position was within 1, 2, 3 sigma of the "
        "stated covariance (a Gaussian gives 68, 95, 99.7 %).",
    )
    simulated_s: float = 0.0
    track: list[tuple[float, float]] = Field(default_factory=list, description="True path [m].")


class Summary(BaseModel):
    """All runs in one world."""

    model_config = ConfigDict(extra="forbid")

    runs: int
    failed: int = Field(description="Number of invalid runs.")
    failures: dict[int, str] = Field(description="Why each of these failed, by seed.")
    events: dict[str, int] = Field(
        description="For each scripted event of the world: the number of valid runs in which it "
        "came due before the end."
    )
    goals: int
    reached: int
    reached_share: float
    kidnapped: int = Field(description="Number of goals on the way to which it was kidnapped.")
    kidnapped_reached: int
    relocalized: int = Field(description="Number of these after which it was relocalized.")
    relocalized_median_s: float | None
    relocalized_worst_s: float | None
    collisions: int
    path_ratio_mean: float | None = Field(
        description="Driven length over the shortest, for goals reached without kidnapping."
    )
    path_ratio_p95: float | None
    seconds_mean: float | None = Field(description="Mean time of these goals [s].")
    recoveries: int
    unsure_s: float = Field(description=f"Time with a health below {SURE_HEALTH}, all goals [s].")
    misled_s: float = Field(
        description=f"Longest time with a health of at least {SURE_HEALTH} while the robot was not "
        "within 0.5 m and 0.5 rad of its estimate [s]."
    )
    end_error_median: float | None = Field(
        description="True distance from the goal where the robot reported success [m]."
    )
    end_error_p95: float | None
    end_turn_median: float | None = Field(description="The same for the heading [rad].")
    end_turn_p95: float | None
    error_median: float | None = Field(description=f"Median over all runs {_ERRORS}.")
    error_p95: float | None = Field(description=f"95th percentile over all runs {_ERRORS}.")
    within: tuple[float, float, float] | None = Field(
        description="Fractions of these poses whose true position was within 1, 2, 3 sigma."
    )
    simulated_s: float


class LocalizationQuality:
    """Position errors of estimated poses, and whether the stated covariance was right."""

    def __init__(self) -> None:
        self.errors: list[float] = []
        self._squares: list[float] = []

    def add(self, estimate: Pose, covariance: NDArray[np.float64], true: Pose) -> None:
        """Add an estimated pose with its covariance (3, 3), and the true pose."""
        error = np.array([estimate[0] - true[0], estimate[1] - true[1]])
        self.errors.append(math.hypot(*error))
        position = covariance[:2, :2]
        # A zero covariance claims an exact position: the truth is never within it.
        valid = np.linalg.det(position) > 0 and np.trace(position) > 0
        self._squares.append(float(error @ np.linalg.solve(position, error)) if valid else math.inf)

    def percentile(self, percent: float) -> float | None:
        """Return a percentile of the errors [m]; None if there are none."""
        return _percentile(self.errors, percent)

    def counts(self) -> dict[int, int]:
        """Return the number of poses by their error in `ERROR_STEP_M`."""
        return dict(sorted(Counter(round(error / ERROR_STEP_M) for error in self.errors).items()))

    def within(self) -> tuple[float, float, float] | None:
        """Return the fractions of poses whose true position was within 1, 2, 3 sigma."""
        if not self._squares:
            return None
        squares = np.array(self._squares)
        one, two, three = (round(float(np.mean(squares <= limit)), 4) for limit in SIGMA_LIMITS)
        return one, two, three


def summarize(runs: Sequence[RunResult], events: Mapping[str, float]) -> Summary:
    """Return the figures of all runs; `events` maps each scripted event to its time [s].

    Path lengths of goals during which the robot was kidnapped are left out.
    """
    durations = [run.simulated_s for run in runs if not run.failure]
    goals = [goal for run in runs for goal in run.goals]
    plain = [g for g in goals if g.reached and not g.kidnapped and g.shortest > 0]
    ratios = [g.driven / g.shortest for g in plain]
    kidnapped = [g for g in goals if g.kidnapped]
    relocalized = [g.relocalized_s for g in kidnapped if g.relocalized_s is not None]
    claimed = [g for g in goals if g.claimed]
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
        relocalized=len(relocalized),
        relocalized_median_s=_percentile(relocalized, 50),
        relocalized_worst_s=max(relocalized, default=None),
        collisions=sum(len(run.collisions) for run in runs),
        path_ratio_mean=float(np.mean(ratios)) if ratios else None,
        path_ratio_p95=_percentile(ratios, 95),
        seconds_mean=float(np.mean([g.seconds for g in plain])) if plain else None,
        recoveries=sum(goal.recoveries for goal in goals),
        unsure_s=sum(goal.unsure_s for goal in goals),
        misled_s=max((goal.misled_s for goal in goals), default=0.0),
        end_error_median=_percentile([g.end_error for g in claimed], 50),
        end_error_p95=_percentile([g.end_error for g in claimed], 95),
        end_turn_median=_percentile([g.end_turn for g in claimed], 50),
        end_turn_p95=_percentile([g.end_turn for g in claimed], 95),
        error_median=_percentile(errors, 50),
        error_p95=_percentile(errors, 95),
        within=_pooled_within(runs),
        simulated_s=sum(run.simulated_s for run in runs),
    )


def pooled_errors(runs: Sequence[RunResult]) -> NDArray[np.float64]:
    """Return the position errors [m] of all runs: a long run weighs more than a short one."""
    steps = [step for run in runs for step in run.error_counts]
    counts = [count for run in runs for count in run.error_counts.values()]
    return np.repeat(np.array(steps, np.float64) * ERROR_STEP_M, np.array(counts, np.int64))


def _pooled_within(runs: Sequence[RunResult]) -> tuple[float, float, float] | None:
    known = [(run.within, sum(run.error_counts.values())) for run in runs if run.within is not None]
    poses = sum(count for _, count in known)
    if not poses:
        return None
    one, two, three = (
        round(sum(shares[sigma] * count for shares, count in known) / poses, 4)
        for sigma in range(3)
    )
    return one, two, three


def _percentile(values: Sequence[float] | NDArray[np.float64], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None
