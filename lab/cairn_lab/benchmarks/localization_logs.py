"""Localization on corrected laser logs of real robots: accuracy, lost stretches, global start.

    python -m cairn_lab.benchmarks.localization_logs [fr079 fr101 ...]

`tests/components/corrected_logs.py` describes how the logs are split into map and judged scans.
"""

from __future__ import annotations

import math
import sys

import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import OccupancyCells
from cairn_lab.benchmarks.result import Metric
from cairn_lab.evaluation.results import SIGMA_LIMITS
from tests.components.corrected_logs import (
    LOGS,
    CorrectedLog,
    LogRun,
    draw_map,
    drive,
    from_known_start,
    load_log,
    mapped_by_scans,
    mapped_by_stretches,
    new_localizer,
)

LOST_M = 1.0
START_TRIES, START_LASTS_S = 20, 90.0


def lost_stretches(outcome: LogRun) -> list[tuple[float, float]]:
    """Return the times [s] at which the error rose above the limit and fell below it again."""
    stretches = []
    begin = None
    for time, error in zip(outcome.time, outcome.error, strict=True):
        if error > LOST_M and begin is None:
            begin = float(time)
        elif error <= LOST_M and begin is not None:
            stretches.append((begin, float(time)))
            begin = None
    if begin is not None:
        stretches.append((begin, float(outcome.time[-1])))
    return stretches


def starts(
    log: CorrectedLog,
    grid: OccupancyCells,
    mapped: NDArray[np.bool_],
    seed: int,
    tries: int = START_TRIES,
) -> tuple[list[float], list[float]]:
    """Return errors [m] of the first estimates and the times [s] until them; inf if there is none.

    The tries begin at random times in the held-out stretches.
    """
    random = np.random.default_rng(seed)
    held_out = np.nonzero(~mapped & (log.scan_at < log.scan_at[-1] - START_LASTS_S))[0]
    every = np.ones(len(log.scans), bool)
    errors, times = [], []
    for n, k in enumerate(random.choice(held_out, tries, replace=False)):
        begin = float(log.scan_at[k])
        robot = new_localizer(grid, seed + n)
        robot.advance(begin)
        outcome = drive(robot, log, every, begin, begin + START_LASTS_S, until_located=True)
        found = not math.isnan(outcome.error[-1])
        errors.append(float(outcome.error[-1]) if found else math.inf)
        times.append(float(outcome.time[-1]) - begin if found else math.inf)
    return errors, times


def measure_log(name: str, seed: int = 0) -> list[Metric]:
    """Return the metrics of one log."""
    log = load_log(LOGS[name])
    every = np.ones(len(log.scans), bool)
    mapped = mapped_by_stretches(log)
    grid = draw_map(log, mapped)
    outcome = from_known_start(log, grid, every, seed)
    metrics = _metrics_of(f"{name}, stretches apart", outcome, ~mapped)
    errors, times = starts(log, grid, mapped, seed)
    right = sum(error < 0.5 for error in errors)
    metrics += [
        Metric(f"{name}: located from an unknown start", right / len(errors), "", at_least=0.9,
               note=f"{right} of {len(errors)}; median {np.median(times):.0f} s"),
        Metric(f"{name}: of these at a wrong pose",
               float(sum(0.5 <= e < math.inf for e in errors)), "", at_most=1),
    ]  # fmt: skip
    mapped = mapped_by_scans(log)
    outcome = from_known_start(log, draw_map(log, mapped), ~mapped, seed)
    return metrics + _metrics_of(f"{name}, scans apart", outcome, np.ones(len(outcome.time), bool))


def _metrics_of(name: str, outcome: LogRun, judged: NDArray[np.bool_]) -> list[Metric]:
    error = outcome.error[judged]
    lost = lost_stretches(outcome)
    one, two, three = (float(np.mean(outcome.squares[judged] <= limit)) for limit in SIGMA_LIMITS)
    return [
        Metric(f"{name}: position error, median", float(np.median(error)), "m", at_most=0.15,
               note=f"rms {math.sqrt(np.mean(error**2)):.3f}, 95 % {np.percentile(error, 95):.3f},"
               f" at most {error.max():.2f} m"),
        Metric(f"{name}: heading error, median",
               float(np.median(outcome.heading_error[judged])), "rad"),
        Metric(f"{name}: longest stretch off by more than {LOST_M:g} m",
               max((end - begin for begin, end in lost), default=0.0), "s", at_most=5.0,
               note=", ".join(f"{begin:.0f} to {end:.0f} s" for begin, end in lost)),
        Metric(f"{name}: healthy (at least 0.5) while off by more than {LOST_M:g} m",
               float(np.mean((error > LOST_M) & (outcome.health[judged] >= 0.5))), "of scans",
               at_most=0.005),
        Metric(f"{name}: truth within 1 sigma as stated", one, "of scans", at_least=0.55,
               note=f"within 2: {two:.3f}, 3: {three:.3f}"),
    ]  # fmt: skip


def measure() -> list[Metric]:
    """Return the metrics of all logs."""
    return [metric for name in ("fr101", "fr079") for metric in measure_log(name)]


def main() -> None:
    for name in sys.argv[1:] or ["fr101", "fr079"]:
        for f in measure_log(name):
            verdict = "" if not f.limit else ("kept" if f.kept else "MISSED")
            print(f"{f.name}: {f.value:.3g} {f.unit} ({f.limit} {verdict}) {f.note}")


if __name__ == "__main__":
    main()
