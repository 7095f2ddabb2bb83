"""Localization of a base with wheel contacts, simulated by MuJoCo: odometry with scale and slip.

    pip install './lab[mujoco]'
    python -m cairn_lab.benchmarks.localization_wheels [office ward]

A base of two wheels and a caster follows a tour. Odometry is that of its wheels; the truth is where
the base is. A scanner (270 degrees, 10 m, noise of 1.5 cm) measures at the true poses. SLAM makes
the map from the drive with good grip; the localizer starts at the true pose.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
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
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose, compose, relative, wrap
from cairn.planar.scan_grid import ScanGrid
from cairn.planar.scans import rays_of
from cairn.schemas.sensor_msgs import LaserScan
from cairn_lab.benchmarks.result import Metric
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
_WHEEL_M, _TRACK_M = 0.05, 0.3
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
    mujoco: Any = import_module("mujoco")  # an extra of the lab

    path = courses.path_through(course.world, course.stops)
    model = mujoco.MjModel.from_xml_string(_base_xml(floor))
    data = mujoco.MjData(model)
    heading = math.atan2(path[8, 1] - path[0, 1], path[8, 0] - path[0, 0])
    data.qpos[:2] = path[0]
    data.qpos[3], data.qpos[6] = math.cos(heading / 2), math.sin(heading / 2)
    mujoco.mj_forward(model, data)
    period = 1.0 / _ODOMETRY_PER_S
    steps = round(period / model.opt.timestep)
    times, truth, odometry = [], [], []
    stated: Pose = (float(path[0, 0]), float(path[0, 1]), heading)
    turned = np.array(data.qpos[7:9])
    target, speed, rate = 0, 0.0, 0.0
    while data.time < _LONGEST_S and target < len(path) - 1:
        left, right = (np.array(data.qpos[7:9]) - turned) * _WHEEL_M
        turned = np.array(data.qpos[7:9])
        turn = (right - left) / _TRACK_M
        chord = compose(stated, (0.0, 0.0, turn / 2))
        moved = compose(chord, ((left + right) / 2, 0.0, turn / 2))
        stated = (moved[0], moved[1], stated[2] + turn)
        x, y = data.qpos[:2].tolist()
        w, i, j, k = data.qpos[3:7].tolist()
        theta = math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
        times.append(data.time)
        truth.append((x, y, theta))
        odometry.append(stated)
        while target < len(path) - 1 and math.dist(path[target], (x, y)) < _AHEAD_M:
            target += 1
        aside = wrap(math.atan2(path[target, 1] - y, path[target, 0] - x) - theta)
        wanted = _SPEED * max(0.0, math.cos(aside)) ** 2 if abs(aside) < 1.2 else 0.0
        wanted_rate = float(np.clip(2.5 * aside, -_TURN_RATE, _TURN_RATE))
        speed += float(np.clip(wanted - speed, -_ACCELERATION * period, _ACCELERATION * period))
        rate += float(np.clip(wanted_rate - rate, -_SPIN * period, _SPIN * period))
        half = rate * _TRACK_M / 2
        data.ctrl[:] = (speed - half) / _WHEEL_M, (speed + half) / _WHEEL_M
        mujoco.mj_step(model, data, steps)
    poses = np.array(truth)
    poses[:, 2] = np.unwrap(poses[:, 2])
    wheels = np.array(odometry)
    wheels[:, :2] = wheels[0, :2] + floor.scale * (wheels[:, :2] - wheels[0, :2])
    return Track(np.array(times), wheels, poses)


def _base_xml(floor: Floor) -> str:
    """Return the model of a base on a floor: two wheels, a caster behind, 8.7 kg."""
    slope = math.atan(floor.slope)
    along, down = -9.81 * math.sin(slope), -9.81 * math.cos(slope)
    friction = f'friction="{floor.friction} 0.005 0.0001"'
    wheels = "".join(
        f'<body pos="0 {side * _TRACK_M / 2} 0">'
        f'<joint name="{name}" type="hinge" axis="0 1 0" damping="0.01" armature="0.005"/>'
        f'<geom type="ellipsoid" size="{_WHEEL_M} 0.012 {_WHEEL_M}" mass="0.3" {friction}'
        ' priority="1"/></body>'
        for name, side in (("left", 1), ("right", -1))
    )
    return f"""<mujoco>
      <option timestep="0.002" gravity="{along} 0 {down}" integrator="implicitfast"/>
      <worldbody>
        <geom type="plane" size="100 100 1" {friction}/>
        <body pos="0 0 {_WHEEL_M}"><freejoint/>
          <geom type="cylinder" size="0.18 0.04" pos="-0.025 0 0.03" mass="8" contype="0"
            conaffinity="0"/>
          <geom type="sphere" size="0.02" pos="-0.14 0 {0.02 - _WHEEL_M}" mass="0.1"
            friction="0.001 0 0" priority="1"/>
          {wheels}
        </body>
      </worldbody>
      <actuator>
        <velocity joint="left" kv="1" ctrlrange="-30 30"/>
        <velocity joint="right" kv="1" ctrlrange="-30 30"/>
      </actuator>
    </mujoco>"""


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


def main() -> None:
    for one in measure(tuple(sys.argv[1:]) or ("office", "ward")):
        verdict = "" if not one.limit else f" ({one.limit} {'kept' if one.kept else 'MISSED'})"
        print(f"{one.name}: {one.value:.4f} {one.unit}{verdict} {one.note}", flush=True)


if __name__ == "__main__":
    main()
