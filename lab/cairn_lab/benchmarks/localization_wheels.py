"""Localization of a base with wheel contacts, simulated by MuJoCo: odometry with scale and slip.

    pip install './lab[mujoco]'
    python -m cairn_lab.benchmarks.localization_wheels [office ward]
    python -m cairn_lab.benchmarks.localization_wheels --missions [office ward]

A base of two wheels and a caster follows a tour. Odometry is that of its wheels; the truth is where
the base is. A scanner (270 degrees, 10 m, noise of 1.5 cm) measures at the true poses. SLAM makes
the map from the drive with good grip; the localizer starts at the true pose. With `--missions`, the
whole navigation system drives such a base to random goals, in the true map.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.scanner import (
    BeamPattern,
    ScannerModel,
    SimulatedScannerConfig,
    simulate_sweep,
)
from cairn.components.simulation.world_tracker import RayTargets, sensor_poses
from cairn.components.slam.mapping import Mapper
from cairn.deployment.shipped import FOLDER, world_file
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose, compose, relative, wrap
from cairn.planar.scan_grid import ScanGrid
from cairn.planar.scans import rays_of
from cairn.schemas.sensor_msgs import LaserScan
from cairn_lab.benchmarks.result import Metric
from cairn_lab.contact_base import WheelContacts
from cairn_lab.evaluation.results import RunResult, summarize
from cairn_lab.evaluation.runs import Trial, robot_start, run_trial, survey
from tests.components.corrected_logs import CorrectedLog, from_known_start
from tests.components.slam import courses
from tests.components.slam.courses import Course
from tests.components.slam.map_errors import alignment_to

Array = NDArray[np.float64]

MEDIAN_M, P95_M, WITHIN_2_SIGMA = 0.02, 0.05, 0.9
_SCANNER = ScannerModel(
    -math.radians(135), math.radians(135), 541, 1 / 20, 0.1, 10.0, noise_m=0.015, noise_share=0.0
)
_MOUNT: Pose = (0.1, 0.0, 0.0)
_SCANS_PER_S, _ODOMETRY_PER_S, _LONGEST_S = 10.0, 50.0, 900.0
# The base steers to the point of its path this far ahead [m], up to these speeds and accelerations.
_AHEAD_M, _SPEED, _ACCELERATION, _TURN_RATE, _SPIN = 0.3, 0.6, 1.5, 1.2, 5.0
_CHI_SQUARE_2_SIGMA = 6.18  # of two dimensions: 95.4 %


@dataclass(frozen=True)
class Floor:
    """What a base drives on: friction and slope [1]; odometry is `scale` times as long as its way.

    Of a floor that is not `judged`, figures are only reported.
    """

    name: str
    friction: float
    slope: float = 0.0
    scale: float = 1.0
    judged: bool = True


FLOORS = (
    Floor("good grip", 0.9),
    Floor("odometry 4 % too long", 0.9, scale=1.04),
    Floor("friction 0.2", 0.2),
    Floor("friction 0.2, slope of 3 %", 0.2, 0.03),
    Floor("friction 0.08, slope of 3 %", 0.08, 0.03, judged=False),
)


@dataclass(frozen=True)
class Track:
    """Times (n,) [s], and poses (n, 3) of the odometry and of the base, headings not wrapped."""

    times: Array
    odometry: Array
    truth: Array

    def at(self, poses: Array, times: Array) -> Array:
        """Return poses (m, 3) at some times (m,) [s]."""
        return np.column_stack([np.interp(times, self.times, column) for column in poses.T])


def drive(course: Course, floor: Floor) -> Track:
    """Drive along a course with wheels that touch the floor."""
    path = courses.path_through(course.world, course.stops)
    heading = math.atan2(path[8, 1] - path[0, 1], path[8, 0] - path[0, 0])
    start = (float(path[0, 0]), float(path[0, 1]), heading)
    base = WheelContacts(floor.friction, floor.slope, floor.scale, start)
    period = 1.0 / _ODOMETRY_PER_S
    times, truth, odometry = [], [], []
    target, speed, rate = 0, 0.0, 0.0
    while base.time_s < _LONGEST_S and target < len(path) - 1:
        x, y, theta = base.pose
        times.append(base.time_s)
        truth.append((x, y, theta))
        odometry.append(base.odometry)
        while target < len(path) - 1 and math.dist(path[target], (x, y)) < _AHEAD_M:
            target += 1
        aside = wrap(math.atan2(path[target, 1] - y, path[target, 0] - x) - theta)
        wanted = _SPEED * max(0.0, math.cos(aside)) ** 2 if abs(aside) < 1.2 else 0.0
        wanted_rate = float(np.clip(2.5 * aside, -_TURN_RATE, _TURN_RATE))
        speed += float(np.clip(wanted - speed, -_ACCELERATION * period, _ACCELERATION * period))
        rate += float(np.clip(wanted_rate - rate, -_SPIN * period, _SPIN * period))
        base.roll(period, speed, rate)
    poses = np.array(truth)
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Track(np.array(times), np.array(odometry), poses)


def sweeps(course: Course, track: Track, seed: int) -> Iterator[tuple[float, LaserScan, Pose]]:
    """Yield the time of the last beam [s] of each scan, the scan, and its motion by odometry."""
    solid = WorldLayout.of(course.world).solid_segments
    targets = RayTargets(solid.segments, solid.surfaces, np.zeros((0, 3)))
    beams = BeamPattern.of(_SCANNER, -math.pi, math.pi, 1)
    random = np.random.default_rng(seed)
    end = float(beams.times[-1])
    for begin in np.arange(0.1, track.times[-1] - end, 1.0 / _SCANS_PER_S):
        poses = sensor_poses(track.at(track.truth, begin + beams.times), _MOUNT)
        ranges = simulate_sweep(_SCANNER, beams, SimulatedScannerConfig(), poses, targets, random)
        first, last = track.at(track.odometry, np.array([begin, begin + end])).tolist()
        yield float(begin) + end, _scan(beams, ranges), relative(tuple(first), tuple(last))


def _scan(beams: BeamPattern, ranges: Any) -> LaserScan:
    return LaserScan(
        angle_min=float(beams.angles[0]),
        angle_max=float(beams.angles[-1]),
        angle_increment=_SCANNER.increment,
        time_increment=_SCANNER.time_increment,
        range_min=_SCANNER.least,
        range_max=_SCANNER.most,
        ranges=ranges,
    )


def mapped(course: Course, track: Track) -> OccupancyCells:
    """Return the map that SLAM makes of a drive, in the frame of the world."""
    mapper = Mapper(30.0)
    times = []
    for time, scan, moved in sweeps(course, track, seed=100):
        x, y, theta = track.at(track.odometry, np.array([time]))[0].tolist()
        mapper.add_scan(round(time * 1e9), (x, y, theta), rays_of(scan, _MOUNT, moved))
        times.append(time)
    mapper.finish()
    shift = alignment_to(track.at(track.truth, np.array(times)), mapper.poses())
    grid = ScanGrid(0.05, 30.0)
    for number, frame in enumerate(mapper.keyframes):
        if frame.rays is not None:
            grid.add(compose(shift, mapper.graph.pose(number)), frame.rays.rays())
    return grid.grid()


def measure(worlds: tuple[str, ...] = ("office", "ward"), seed: int = 0) -> list[Metric]:
    """Return the metrics of all floors in some shipped worlds."""
    metrics: list[Metric] = []
    for world in worlds:
        course = courses.shipped(world)
        grid = mapped(course, drive(course, FLOORS[0]))
        for floor in FLOORS:
            metrics += _measure(world, course, floor, grid, seed)
    return metrics


def _measure(
    world: str, course: Course, floor: Floor, grid: OccupancyCells, seed: int
) -> Iterator[Metric]:
    name = f"{world}, {floor.name}"
    track = drive(course, floor)
    found = list(sweeps(course, track, seed))
    at = np.array([time for time, _, _ in found])
    log = CorrectedLog(
        odometry_at=track.times,
        odometry=track.odometry,
        scan_at=at,
        scans=[],
        points=[rays_of(scan, _MOUNT, moved).points() for _, scan, moved in found],
        laser=[],
        truth=track.at(track.truth, at),
    )
    run = from_known_start(log, grid, np.ones(len(at), np.bool_), seed)
    ways = [
        np.hypot(*np.diff(poses[:, :2], axis=0).T).sum() for poses in (track.odometry, log.truth)
    ]
    within = float(np.mean(run.squares <= _CHI_SQUARE_2_SIGMA))
    limits = (MEDIAN_M, P95_M, WITHIN_2_SIGMA) if floor.judged else (None, None, None)
    yield Metric(f"{name}: median error", float(np.median(run.error)), "m", at_most=limits[0],
                 note=f"odometry {ways[0] / ways[1] - 1.0:+.1%} too long")  # fmt: skip
    yield Metric(f"{name}: 95 %", float(np.percentile(run.error, 95)), "m", at_most=limits[1])
    yield Metric(f"{name}: truth within 2 sigma", within, "", at_least=limits[2])


_GOALS, _SEEDS = 4, (0, 1)
_BASE = "components.mobile_supervisor.children.base"


def missions(worlds: tuple[str, ...] = ("office", "ward")) -> Iterator[Metric]:
    """Yield the metrics of missions on all floors in some shipped worlds."""
    for world in worlds:
        usual_s = math.nan
        for floor in FLOORS:
            summary = summarize(_missions(world_file(world), floor), {})
            took_s = summary.seconds_mean or math.inf
            if math.isnan(usual_s):
                usual_s = took_s
            name = f"{world}, {floor.name}"
            least = 100.0 if floor.judged else None
            note = f"{took_s:.1f} s per goal, {took_s / usual_s - 1.0:+.0%}"
            share = 100.0 * summary.reached_share
            yield Metric(f"{name}: goals reached", share, "%", at_least=least, note=note)
            most = 0.0 if floor.judged else None
            yield Metric(f"{name}: unsure of the pose", summary.unsure_s, "s", at_most=most)
            yield Metric(f"{name}: collisions", summary.collisions, "", at_most=most)


def _missions(world: Path, floor: Floor) -> list[RunResult]:
    with TemporaryDirectory() as folder:
        maps = Path(folder, "world.yaml"), Path(folder, "world.cairn")
        survey(world, *maps)
        trial = Trial(
            deployment=FOLDER / "sim.yaml",
            world=world,
            map_file=maps[0],
            visual_map=maps[1],
            start=robot_start(world),
            goals=_GOALS,
            kidnap_at=0,
            sets=(
                f"{_BASE}.plugin=cairn_lab.contact_base:ContactBase",
                f"{_BASE}.parameters.friction={floor.friction}",
                f"{_BASE}.parameters.slope={floor.slope}",
                f"{_BASE}.parameters.odometry_scale={floor.scale}",
                # All slip is that of the contacts.
                "components.world.parameters.slip.distance=0",
                "components.world.parameters.slip.turn=0",
                "components.world.parameters.slip.turn_per_meter=0",
            ),
        )
        return [run_trial(trial, seed) for seed in _SEEDS]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("worlds", nargs="*", default=["office", "ward"])
    parser.add_argument("--missions", action="store_true")
    arguments = parser.parse_args()
    worlds = tuple(arguments.worlds)
    for one in missions(worlds) if arguments.missions else measure(worlds):
        verdict = "" if not one.limit else f" ({one.limit} {'kept' if one.kept else 'MISSED'})"
        print(f"{one.name}: {one.value:.4f} {one.unit}{verdict} {one.note}", flush=True)


if __name__ == "__main__":
    main()
