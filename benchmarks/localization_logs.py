"""Localization on recordings of real robots, with maps of other stretches of the same recording.

    python -m benchmarks.localization_logs [fr079 fr101 ...]

The time of a log is cut into stretches of 20 s. Scans of every other stretch, at their corrected
poses, draw the map; the robot drives through the whole log by raw odometry and scans, and counts
where its scans had no part in the map. Halves of the logs would not do: neither half has seen all
that the other sees. Stretches are long enough to get lost in, and most of a held-out scan shows
what another visit or another stretch has seen. `scans apart` is the split scan by scan instead: no
scan that the robot is given had a part in the map.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.result import Figure
from cairn.components.localizer.config import LocalizationSettings, MeasuredBase
from cairn.components.localizer.localization import Localization
from cairn.components.localizer.odometry import MeasuredTrack
from cairn.components.map_builder.grid_from_scans import build_grid
from cairn.components.replay.carmen import CarmenRecording
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose, wrap
from cairn.planar.scans import beams_of
from cairn.schemas.sensor_msgs import LaserScan
from cairn.tools.evaluation.results import SIGMA_LIMITS

Array = NDArray[np.float64]

ROOT = Path(__file__).parent.parent
LOGS = {
    "fr079": ROOT / "deploy" / "recordings" / "fr079_corrected.log.gz",
    "fr101": ROOT / "tests" / "data" / "carmen" / "fr101_corrected.log.gz",
}
STRETCH_S = 20.0
RESOLUTION, REACH_M = 0.05, 30.0
MOUNT: Pose = (-0.04, 0.0, 0.0)
SCAN_DELAY_S = 0.13
LOST_M = 1.0
START_TRIES, START_LASTS_S = 20, 90.0


@dataclass(frozen=True)
class Log:
    """Times [s] from the first scan on: odometry (n), poses (n, 3); scans and what they hit, the
    laser's and the robot's corrected poses at them.
    """

    odometry_at: Array
    odometry: Array
    scan_at: Array
    scans: list[LaserScan]
    points: list[Array]
    laser: list[Pose]
    truth: Array


@dataclass(frozen=True)
class Outcome:
    """At each scan that was given: time [s], errors [m] and [rad] (NaN while not located),
    health, squared Mahalanobis distance of the true position by the stated covariance.
    """

    time: Array
    error: Array
    turned: Array
    health: Array
    squares: Array


def load(path: Path) -> Log:
    """Read a corrected log."""
    recording = CarmenRecording(path, SCAN_DELAY_S)
    odometry, truth = recording.odometry(), recording.truth()
    if odometry is None or truth is None:
        raise ValueError(f"{path} has no odometry or no corrected poses")
    posed = list(recording.posed_scans())
    begin = truth.stamps[0]
    return Log(
        (np.array(odometry.stamps) - begin) / 1e9,
        odometry.poses,
        (np.array(truth.stamps) - begin) / 1e9,
        [scan for _, scan in posed],
        [beams_of(scan, MOUNT).points() for _, scan in posed],
        [pose for pose, _ in posed],
        truth.poses,
    )


def mapped_by_stretches(log: Log) -> NDArray[np.bool_]:
    """Which scans draw the map if every other stretch does."""
    return np.asarray(np.floor(log.scan_at / STRETCH_S) % 2 == 0)


def mapped_by_scans(log: Log) -> NDArray[np.bool_]:
    """Which scans draw the map if every other one does."""
    return np.asarray(np.arange(len(log.scans)) % 2 == 0)


def draw_map(log: Log, mapped: NDArray[np.bool_]) -> OccupancyCells:
    """The map that some of the scans draw."""
    chosen = [(log.laser[k], log.scans[k]) for k in np.nonzero(mapped)[0]]
    return build_grid(chosen, RESOLUTION, (0.0, 0.0, 0.0), REACH_M)


def localization(grid: OccupancyCells, seed: int) -> Localization:
    """The localizer with its default parameters."""
    settings = LocalizationSettings(particles=500, motion=MeasuredBase().model())
    one = Localization(settings, MeasuredTrack(), np.random.default_rng(seed))
    one.set_grid(grid)
    return one


def drive(
    robot: Localization,
    log: Log,
    given: NDArray[np.bool_],
    begin_s: float = 0.0,
    end_s: float = math.inf,
    until_found: bool = False,
) -> Outcome:
    """Give the robot odometry and those scans that are `given`, from `begin_s` to `end_s`."""
    rows = []
    next_odometry = max(0, int(np.searchsorted(log.odometry_at, begin_s)) - 1)
    for k in np.nonzero(given & (log.scan_at >= begin_s) & (log.scan_at <= end_s))[0]:
        time = float(log.scan_at[k])
        while next_odometry < len(log.odometry_at):
            x, y, theta = log.odometry[next_odometry].tolist()
            robot.add_odometry(float(log.odometry_at[next_odometry]), (x, y, theta), 0.0, 0.0)
            next_odometry += 1
            if log.odometry_at[next_odometry - 1] >= time:
                break
        robot.fuse_scan(time, log.points[k])
        if not robot.located:
            rows.append((time, math.nan, math.nan, 0.0, math.nan))
            continue
        pose = robot.pose()
        x, y, theta = log.truth[k].tolist()
        error = math.hypot(pose.mean[0] - x, pose.mean[1] - y)
        turned = abs(wrap(pose.mean[2] - theta))
        off = np.array([pose.mean[0] - x, pose.mean[1] - y])
        square = float(off @ np.linalg.solve(pose.covariance[:2, :2], off))
        rows.append((time, error, turned, robot.health().value, square))
        if until_found:
            break
    return Outcome(*np.array(rows).reshape(-1, 5).T)


def from_known_start(
    log: Log, grid: OccupancyCells, given: NDArray[np.bool_], seed: int, begin_s: float = 0.0,
    end_s: float = math.inf,
) -> Outcome:  # fmt: skip
    """Drive from where the robot is at `begin_s` on."""
    robot = localization(grid, seed)
    first = int(np.searchsorted(log.scan_at, begin_s))
    robot.advance(float(log.scan_at[first]))
    x, y, theta = log.truth[first].tolist()
    robot.set_pose((x, y, theta), np.diag([0.05**2, 0.05**2, 0.03**2]))
    return drive(robot, log, given, begin_s, end_s)


def lost_stretches(outcome: Outcome) -> list[tuple[float, float]]:
    """From when to when [s] the error was above the limit."""
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
    log: Log, grid: OccupancyCells, mapped: NDArray[np.bool_], seed: int
) -> tuple[list[float], list[float]]:
    """Errors [m] where the robot first claimed to be, and times [s] that took; inf if it never
    did, of tries that begin at random times in the held-out stretches.
    """
    random = np.random.default_rng(seed)
    held_out = np.nonzero(~mapped & (log.scan_at < log.scan_at[-1] - START_LASTS_S))[0]
    every = np.ones(len(log.scans), bool)
    errors, took = [], []
    for n, k in enumerate(random.choice(held_out, START_TRIES, replace=False)):
        begin = float(log.scan_at[k])
        robot = localization(grid, seed + n)
        robot.advance(begin)
        outcome = drive(robot, log, every, begin, begin + START_LASTS_S, until_found=True)
        found = not math.isnan(outcome.error[-1])
        errors.append(float(outcome.error[-1]) if found else math.inf)
        took.append(float(outcome.time[-1]) - begin if found else math.inf)
    return errors, took


def measure_log(name: str, seed: int = 0) -> list[Figure]:
    """The figures of one log."""
    log = load(LOGS[name])
    every = np.ones(len(log.scans), bool)
    mapped = mapped_by_stretches(log)
    grid = draw_map(log, mapped)
    outcome = from_known_start(log, grid, every, seed)
    figures = _driven(f"{name}, stretches apart", outcome, ~mapped)
    errors, took = starts(log, grid, mapped, seed)
    right = sum(error < 0.5 for error in errors)
    figures += [
        Figure(f"{name}: found from an unknown start", right / len(errors), "", at_least=0.9,
               note=f"{right} of {len(errors)}; median {np.median(took):.0f} s"),
        Figure(f"{name}: of these in a wrong place",
               float(sum(0.5 <= e < math.inf for e in errors)), "", at_most=1),
    ]  # fmt: skip
    mapped = mapped_by_scans(log)
    outcome = from_known_start(log, draw_map(log, mapped), ~mapped, seed)
    return figures + _driven(f"{name}, scans apart", outcome, np.ones(len(outcome.time), bool))


def _driven(what: str, outcome: Outcome, judged: NDArray[np.bool_]) -> list[Figure]:
    error = outcome.error[judged]
    lost = lost_stretches(outcome)
    one, two, three = (float(np.mean(outcome.squares[judged] <= limit)) for limit in SIGMA_LIMITS)
    return [
        Figure(f"{what}: position error, median", float(np.median(error)), "m", at_most=0.15,
               note=f"rms {math.sqrt(np.mean(error**2)):.3f}, 95 % {np.percentile(error, 95):.3f},"
               f" at most {error.max():.2f} m"),
        Figure(f"{what}: heading error, median", float(np.median(outcome.turned[judged])), "rad"),
        Figure(f"{what}: longest stretch off by more than {LOST_M:g} m",
               max((end - begin for begin, end in lost), default=0.0), "s", at_most=5.0,
               note=", ".join(f"{begin:.0f} to {end:.0f} s" for begin, end in lost)),
        Figure(f"{what}: said to be well (0.5 up) while off by more than {LOST_M:g} m",
               float(np.mean((error > LOST_M) & (outcome.health[judged] >= 0.5))), "of scans",
               at_most=0.005),
        Figure(f"{what}: truth within 1 sigma as stated", one, "of scans", at_least=0.55,
               note=f"within 2: {two:.3f}, 3: {three:.3f}"),
    ]  # fmt: skip


def measure() -> list[Figure]:
    """All logs."""
    return [figure for name in ("fr101", "fr079") for figure in measure_log(name)]


def main() -> None:
    for name in sys.argv[1:] or ["fr101", "fr079"]:
        for f in measure_log(name):
            verdict = "" if not f.limit else ("kept" if f.kept else "MISSED")
            print(f"{f.name}: {f.value:.3g} {f.unit} ({f.limit} {verdict}) {f.note}")


if __name__ == "__main__":
    main()
