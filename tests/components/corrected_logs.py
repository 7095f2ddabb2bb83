"""The localizer on corrected laser logs of real robots, in maps of other stretches of the same log.

The time of a log is cut into stretches of 20 s. Scans of every other stretch, at their corrected
poses, draw the map; the robot drives through the whole log by raw odometry and scans, and is judged
where its scans did not contribute to the map. Halves of a log would not do: neither half has seen
all that the other sees. Stretches are long enough to get lost in, and most of a held-out scan shows
what another visit or another stretch has seen. The alternative is to split scan by scan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.config import LocalizationSettings, MeasuredBase
from cairn.components.localizer.localization import Localization
from cairn.components.localizer.odometry import MeasuredTrack
from cairn.components.replay_devices.carmen import CarmenRecording
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose, compose, inverse, wrap
from cairn.planar.scan_grid import build_grid
from cairn.planar.scans import beams_of
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[2]
LOGS = {
    "fr079": ROOT / "deploy" / "recordings" / "fr079_corrected.log.gz",
    "fr101": ROOT / "tests" / "data" / "carmen" / "fr101_corrected.log.gz",
}
STRETCH_S = 20.0
RESOLUTION, LONGEST_RANGE_M = 0.05, 30.0
MOUNT: Pose = (-0.04, 0.0, 0.0)
SCAN_DELAY_S = 0.13


@dataclass(frozen=True)
class CorrectedLog:
    """Odometry poses (n, 3) and scans with their stamps [s] from the first scan on.

    Each scan has its end points, and the corrected poses of the laser and of the robot (truth).
    """

    odometry_at: Array
    odometry: Array
    scan_at: Array
    scans: list[LaserScan]
    points: list[Array]
    laser: list[Pose]
    truth: Array


@dataclass(frozen=True)
class LogRun:
    """At each fused scan: time [s], errors [m] and [rad] (NaN while not located), health, and the
    squared Mahalanobis distance of the true position by the stated covariance.
    """

    time: Array
    error: Array
    heading_error: Array
    health: Array
    squares: Array


def load_log(path: Path) -> CorrectedLog:
    """Read a corrected log."""
    recording = CarmenRecording(path, SCAN_DELAY_S)
    odometry, truth = recording.odometry(), recording.truth()
    if odometry is None or truth is None:
        raise ValueError(f"{path} has no odometry or no corrected poses")
    posed = list(recording.posed_scans())
    begin = truth.stamps[0]
    # What was corrected is the pose of the laser: fr101 states the same one for the robot.
    base = inverse(MOUNT)
    return CorrectedLog(
        (np.array(odometry.stamps) - begin) / 1e9,
        odometry.poses,
        (np.array(truth.stamps) - begin) / 1e9,
        [scan for _, scan in posed],
        [beams_of(scan, MOUNT).points() for _, scan in posed],
        [pose for pose, _ in posed],
        np.array([compose(pose, base) for pose, _ in posed]),
    )


def mapped_by_stretches(log: CorrectedLog) -> NDArray[np.bool_]:
    """Return which scans draw the map: those of every other stretch."""
    return np.asarray(np.floor(log.scan_at / STRETCH_S) % 2 == 0)


def mapped_by_scans(log: CorrectedLog) -> NDArray[np.bool_]:
    """Return which scans draw the map: every other scan."""
    return np.asarray(np.arange(len(log.scans)) % 2 == 0)


def draw_map(log: CorrectedLog, mapped: NDArray[np.bool_]) -> OccupancyCells:
    """Return the map drawn by some of the scans."""
    chosen = [(log.laser[k], log.scans[k]) for k in np.nonzero(mapped)[0]]
    return build_grid(chosen, RESOLUTION, (0.0, 0.0, 0.0), LONGEST_RANGE_M)


def new_localizer(grid: OccupancyCells, seed: int) -> Localization:
    """Return the localizer with its default parameters."""
    settings = LocalizationSettings(particles=500, motion=MeasuredBase().model())
    one = Localization(settings, MeasuredTrack(), np.random.default_rng(seed))
    one.set_grid(grid)
    return one


def drive(
    robot: Localization,
    log: CorrectedLog,
    fused: NDArray[np.bool_],
    begin_s: float = 0.0,
    end_s: float = math.inf,
    until_located: bool = False,
) -> LogRun:
    """Drive by odometry and those scans that are to be `fused`, from `begin_s` to `end_s`."""
    rows = []
    next_odometry = max(0, int(np.searchsorted(log.odometry_at, begin_s)) - 1)
    for k in np.nonzero(fused & (log.scan_at >= begin_s) & (log.scan_at <= end_s))[0]:
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
        if until_located:
            break
    return LogRun(*np.array(rows).reshape(-1, 5).T)


def from_known_start(
    log: CorrectedLog,
    grid: OccupancyCells,
    fused: NDArray[np.bool_],
    seed: int,
    begin_s: float = 0.0,
    end_s: float = math.inf,
) -> LogRun:
    """Drive from the true pose at `begin_s` on."""
    robot = new_localizer(grid, seed)
    first = int(np.searchsorted(log.scan_at, begin_s))
    robot.advance(float(log.scan_at[first]))
    x, y, theta = log.truth[first].tolist()
    robot.set_pose((x, y, theta), np.diag([0.05**2, 0.05**2, 0.03**2]))
    return drive(robot, log, fused, begin_s, end_s)
