"""Localization by a raw CARMEN log in a map of another log: lost episodes, kidnapping, accuracy.

    python -m cairn_lab.benchmarks.localization_raw MAP_LOG RAW_LOG [--relations FILE]
        [--start X Y THETA] [--kidnap-every 300 --hours 1] [--seed 1]

`MAP_LOG` has corrected poses, from which the map is drawn; `RAW_LOG` has odometry and scans of the
same building. Relations are checked relative poses of two scans: t1 t2 x y z roll pitch yaw, as in
the SLAM benchmark of Freiburg. With `--kidnap-every`, parts of the log of so many seconds follow
each other in random order, and odometry knows nothing of the way between them; the truth is then
the pose of a robot that drives through the whole log from its known start.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.localization import Localization
from cairn.components.replay_devices.carmen import CarmenRecording
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose, compose, distance, relative
from cairn.planar.scan_grid import build_grid
from cairn.planar.scans import beams_of
from tests.components.corrected_logs import LONGEST_RANGE_M, RESOLUTION, new_localizer

Array = NDArray[np.float64]

MOUNT: Pose = (0.0, 0.0, 0.0)
JUMP_M, FOUND_M, HEALTHY = 1.0, 0.5, 0.5
KNOWN = np.diag([0.05**2, 0.05**2, 0.03**2])


@dataclass(frozen=True)
class RawLog:
    """Odometry poses (n, 3) and scans, at times [s] since the first; `stamps` [s] of the log."""

    odometry_at: Array
    odometry: Array
    scan_at: Array
    stamps: Array
    points: list[Array]
    misses: list[tuple[Array, Array]]


@dataclass(frozen=True)
class Step:
    """After a scan: its index, the way driven [m], the pose if there is one, its health."""

    index: int
    way_m: float
    pose: Pose | None
    health: float
    jumped_m: float


def read_raw(path: Path) -> RawLog:
    """Read a log with odometry and scans."""
    recording = CarmenRecording(path)
    odometry, scans = recording.odometry(), recording.scans()
    if odometry is None or scans is None:
        raise ValueError(f"{path} has no odometry or no scans")
    begin = min(odometry.stamps[0], scans.stamps[0])
    beams = [beams_of(scan, MOUNT) for scan in scans.messages]
    return RawLog(
        (np.array(odometry.stamps) - begin) / 1e9,
        odometry.poses,
        (np.array(scans.stamps) - begin) / 1e9,
        np.array(scans.stamps) / 1e9,
        [one.points() for one in beams],
        [one.rays((0.0, 0.0, 0.0)).misses() for one in beams],
    )


def draw(path: Path) -> OccupancyCells:
    """Return the map of a log with corrected poses."""
    posed = list(CarmenRecording(path).posed_scans())
    return build_grid(posed, RESOLUTION, (0.0, 0.0, 0.0), LONGEST_RANGE_M)


def drive(
    robot: Localization, log: RawLog, begin_s: float, end_s: float, at_s: float, from_pose: Pose
) -> Iterator[Step]:
    """Drive through a part of a log, at the time `at_s` [s] of the robot.

    Its odometry begins at `from_pose`.
    """
    chosen = np.nonzero((log.scan_at >= begin_s) & (log.scan_at < end_s))[0]
    k = max(0, int(np.searchsorted(log.odometry_at, log.scan_at[chosen[0]])) - 1)
    origin, offset = _pose(log.odometry[k]), at_s - float(log.odometry_at[k])
    last, way_m = from_pose, 0.0
    for index in chosen:
        time = float(log.scan_at[index])
        while k < len(log.odometry_at):
            pose = compose(from_pose, relative(origin, _pose(log.odometry[k])))
            robot.add_odometry(float(log.odometry_at[k]) + offset, pose, 0.0, 0.0)
            way_m, last = way_m + distance(last, pose), pose
            k += 1
            if log.odometry_at[k - 1] >= time:
                break
        before = robot.pose().mean if robot.located else None
        robot.fuse_scan(time + offset, log.points[index], log.misses[index])
        after = robot.pose().mean if robot.located else None
        jumped_m = distance(before, after) if before and after else 0.0
        yield Step(int(index), way_m, after, robot.health().value, jumped_m)


def kidnapped(
    grid: OccupancyCells,
    log: RawLog,
    truth: list[Pose | None],
    every_s: float,
    total_s: float,
    seed: int,
) -> None:
    """Print where the robot was found after each part, and the jumps to wrong positions."""
    random = np.random.default_rng(seed)
    robot = new_localizer(grid, seed)
    ways, false, wrong, scans, odometry = [], 0, 0, 0, (0.0, 0.0, 0.0)
    for number in range(math.ceil(total_s / every_s)):
        begin_s = float(random.uniform(0.0, log.scan_at[-1] - every_s))
        at_s = number * (every_s + 1.0)
        first = int(np.searchsorted(log.scan_at, begin_s))
        if number == 0 and (start := truth[first]) is not None:
            robot.advance(at_s)
            robot.set_pose(start, KNOWN)
        found_m = None
        for step in drive(robot, log, begin_s, begin_s + every_s, at_s, odometry):
            true = truth[step.index]
            if true is None or step.pose is None:
                continue
            error = distance(step.pose, true)
            scans += 1
            false += step.jumped_m > JUMP_M and error > JUMP_M
            wrong += error > JUMP_M and step.health >= HEALTHY
            if error < FOUND_M and found_m is None:
                found_m = step.way_m
        ways.append(math.inf if found_m is None else found_m)
    print(
        f"seed {seed}: {len(ways)} parts; found after {np.median(ways[1:]):.1f} m (median), "
        f"{max(ways):.1f} m (longest); {false} jumps to wrong positions; healthy while off by more "
        f"than {JUMP_M:g} m in {wrong} of {scans} scans"
    )


def relation_errors(log: RawLog, poses: list[Pose | None], path: Path) -> Array:
    """Return the errors [m] of the relations between scans that have a pose."""
    index_of = {round(float(stamp), 4): k for k, stamp in enumerate(log.stamps)}
    errors = []
    for line in path.read_text(encoding="utf-8").splitlines():
        row = [float(word) for word in line.split()]
        a, b = (index_of.get(round(stamp, 4)) for stamp in row[:2])
        if a is None or b is None:
            continue
        first, second = poses[a], poses[b]
        if first is not None and second is not None:
            errors.append(distance(relative(first, second), (row[2], row[3], 0.0)))
    return np.array(errors)


def _pose(row: Array) -> Pose:
    x, y, theta = row.tolist()
    return (x, y, theta)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("map_log", type=Path)
    parser.add_argument("raw_log", type=Path)
    parser.add_argument("--relations", type=Path)
    parser.add_argument("--start", type=float, nargs=3)
    parser.add_argument("--kidnap-every", type=float, metavar="SECONDS")
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    grid, log = draw(given.map_log), read_raw(given.raw_log)
    robot = new_localizer(grid, given.seed)
    if given.start:
        robot.advance(float(log.scan_at[0]))
        robot.set_pose(given.start, KNOWN)
    whole = float(log.scan_at[-1]) + 1.0
    steps = list(drive(robot, log, 0.0, whole, 0.0, _pose(log.odometry[0])))
    poses = [step.pose for step in steps]
    jumps = [step for step in steps if step.jumped_m > JUMP_M]
    located = next((step for step in steps if step.pose is not None), None)
    print(f"{len(steps)} scans, {steps[-1].way_m:.0f} m, {len(jumps)} jumps of more than 1 m")
    for step in jumps:
        print(f"  after {log.scan_at[step.index]:.0f} s by {step.jumped_m:.1f} m to {step.pose}")
    if located is None:
        print("not located")
        return
    print(
        f"located after {log.scan_at[located.index]:.0f} s and {located.way_m:.1f} m; healthy in "
        f"{np.mean([step.health >= HEALTHY for step in steps]):.1%} of the scans"
    )
    if given.relations:
        errors = relation_errors(log, poses, given.relations)
        print(
            f"{len(errors)} relations: mean error {errors.mean():.3f} m, 95 % "
            f"{np.percentile(errors, 95):.3f} m, largest {errors.max():.2f} m"
        )
    if given.kidnap_every:
        kidnapped(grid, log, poses, given.kidnap_every, given.hours * 3600.0, given.seed)


if __name__ == "__main__":
    main()
