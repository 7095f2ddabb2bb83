"""Simulated recordings of odometry and scans with the true poses, for tests and benchmarks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.people import Walker, circles_of
from cairn.components.simulation.scanner import (
    MODELS,
    BeamPattern,
    ScannerModel,
    SimulatedScannerConfig,
    simulate_sweep,
)
from cairn.components.simulation.world_tracker import RayTargets, sensor_poses
from cairn.planar.poses import Pose, compose, relative, wrap_all
from cairn.planar.scans import Rays, rays_of
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from tests.components.slam.courses import Course, Point, path_through

Array = NDArray[np.float64]

_TICK_S = 0.02  # of the simulated motion
_SPEED, _TURN_RATE, _ACCELERATION, _SPIN = 0.5, 1.0, 0.7, 3.0  # [m/s], [rad/s] and per second
_AHEAD_M = 0.3  # the robot steers to the point of its path this far ahead
_ROBOT_RADIUS_M = 0.22
_FAULTS = SimulatedScannerConfig(
    dropouts=0.002, dark_dropouts=0.3, dark_reach=0.4, glass_returns=0.1
)


@dataclass(frozen=True)
class Scanner:
    """A scanner on the robot: every `skip`-th beam, scans per second, and where it is mounted."""

    model: ScannerModel
    skip: int
    rate: float
    mount: Pose = (0.1, 0.0, 0.0)


_SICK = ScannerModel(-math.pi / 2, math.pi / 2, 361, 1 / 75, 0.1, 81.0, 0.01, 0.0)

SCANNERS: dict[str, Scanner] = {
    # The SICK at the rate of its serial line in old logs; the Hokuyo as in deploy/sim.yaml.
    "SICK": Scanner(_SICK, 1, 5.0),
    "UST-10LX": Scanner(replace(MODELS["UST-10LX"], noise_m=0.01), 3, 10.0),
    "URG-04LX": Scanner(replace(MODELS["URG-04LX"], noise_share=0.03), 2, 10.0),
    "PBS-03JN": Scanner(replace(MODELS["PBS-03JN"], noise_m=0.01, noise_share=0.01), 1, 10.0),
}


@dataclass(frozen=True)
class OdometryErrors:
    """The errors of odometry.

    Attributes:
        scale: relative error of distances [1].
        drift: mean error of the heading per distance [rad/m].
        wander: standard deviation of the same [rad per square root of m].
        slip: largest share of a turn that odometry does not see, or sees too much [1]; it changes
            at random every few seconds.
        mirrors_reverse: odometry counts backward driving as forward.

    """

    scale: float = 0.02
    drift: float = 0.005
    wander: float = 0.01
    slip: float = 0.1
    mirrors_reverse: bool = False


@dataclass(frozen=True)
class Leg:
    """A drive through stops x, y [m]. Before it, the robot was carried to its first stop.

    Meanwhile odometry moved by `odometry_moved`, as if the wheels had turned; `carried_s` [s]
    passed.
    """

    stops: Sequence[Point]
    odometry_moved: Pose = (0.0, 0.0, 0.0)
    carried_s: float = 1.0
    heading: float | None = None
    reverse: bool = False


@dataclass
class Recording:
    """Scans with the odometry pose and the true pose at each of them; `course` is the world."""

    course: Course
    stamps: list[int] = field(default_factory=list)
    odometry: list[Pose] = field(default_factory=list)
    rays: list[Rays] = field(default_factory=list)
    truth: list[Pose] = field(default_factory=list)
    legs: list[int] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """How long the recording lasts [s]."""
        return (self.stamps[-1] - self.stamps[0]) / 1e9


@dataclass(frozen=True)
class Sweep:
    """A scan of a simulated drive.

    Attributes:
        start_ns: time of the first beam [ns]; the scan's stamp is not set.
        end_ns: time of the last beam [ns].
        scan: what the scanner measured.
        start: pose of the base in the odometry frame at the first beam.
        end: the same at the last beam.
        truth: true pose of the base at the last beam.
        leg: number of the leg.

    """

    start_ns: int
    end_ns: int
    scan: LaserScan
    start: Pose
    end: Pose
    truth: Pose
    leg: int


def record(
    course: Course,
    scanner: Scanner,
    seed: int = 0,
    errors: OdometryErrors | None = None,
    legs: Sequence[Leg] | None = None,
) -> Recording:
    """Drive along the course's stops, or through `legs`, and return what the robot records."""
    recording = Recording(course)
    for sweep in sweeps(course, scanner, seed, errors, legs):
        recording.stamps.append(sweep.end_ns)
        recording.odometry.append(sweep.end)
        moved = relative(sweep.start, sweep.end)
        recording.rays.append(rays_of(sweep.scan, scanner.mount, moved))
        recording.truth.append(sweep.truth)
        recording.legs.append(sweep.leg)
    return recording


def sweeps(
    course: Course,
    scanner: Scanner,
    seed: int = 0,
    errors: OdometryErrors | None = None,
    legs: Sequence[Leg] | None = None,
) -> Iterator[Sweep]:
    """Drive along the course's stops, or through `legs`, and yield the scans one by one."""
    errors = errors or OdometryErrors()
    random = np.random.default_rng(seed)
    layout = WorldLayout.of(course.world)
    solid = layout.solid_segments
    walkers = [Walker.of(person) for person in course.world.people]
    model = scanner.model
    beams = BeamPattern.of(model, -math.pi, math.pi, scanner.skip)
    sweep_s = float(beams.times[-1])
    odometry: Pose = (0.0, 0.0, 0.0)
    clock, due, number = 0.0, 0.0, 0
    slip, slip_left = 0.0, 0.0
    for number, leg in enumerate(legs or [Leg(course.stops)]):
        path = path_through(course.world, leg.stops)
        track = _drive(path, leg.heading, leg.reverse)
        if number:
            odometry = compose(odometry, leg.odometry_moved)
            clock += leg.carried_s
            due = clock
        moves = np.zeros_like(track)
        moves[0] = odometry
        for tick, (before, after) in enumerate(pairwise(track), start=1):
            step = relative(tuple(before.tolist()), tuple(after.tolist()))
            forward = math.copysign(math.hypot(step[0], step[1]), step[0])
            slip_left -= _TICK_S
            if slip_left <= 0.0:
                slip, slip_left = random.uniform(-errors.slip, errors.slip), random.uniform(1, 5)
            turn = step[2] * (1.0 - slip) + errors.drift * forward
            turn += errors.wander * math.sqrt(abs(forward)) * random.standard_normal()
            counted = abs(forward) if errors.mirrors_reverse else forward
            odometry = compose(odometry, ((1.0 + errors.scale) * counted, 0.0, turn))
            moves[tick] = odometry
        times = np.asarray(clock + _TICK_S * np.arange(len(track)), np.float64)
        for one in (track, moves):
            one[:, 2] = np.unwrap(one[:, 2])
        last = clock
        while due + sweep_s < times[-1]:
            # Only what lies around the sweep: a drive may last for hours.
            first = max(0, int((due - clock) / _TICK_S) - 1)
            window = slice(first, first + int(sweep_s / _TICK_S) + 5)
            at = sensor_times(
                times[window], track[window], np.asarray(due + beams.times, np.float64)
            )
            for walker in walkers:
                walker.step(max(0.0, due - last), tuple(at[0, :2].tolist()), _ROBOT_RADIUS_M,
                            solid.segments)  # fmt: skip
            last = due
            targets = RayTargets(solid.segments, solid.surfaces, circles_of(walkers))
            poses = sensor_poses(at, scanner.mount)
            ranges = simulate_sweep(model, beams, _FAULTS, poses, targets, random)
            begin, end = sensor_times(
                times[window], moves[window], np.array((due, due + sweep_s), np.float64)
            ).tolist()
            scan = LaserScan(
                header=Header(frame_id="laser"),
                angle_min=float(beams.angles[0]),
                angle_max=float(beams.angles[-1]),
                angle_increment=scanner.skip * model.increment,
                time_increment=scanner.skip * model.time_increment,
                range_min=model.least,
                range_max=model.most,
                ranges=ranges,
            )
            yield Sweep(
                start_ns=round(due * 1e9),
                end_ns=round((due + sweep_s) * 1e9),
                scan=scan,
                start=tuple(begin),
                end=tuple(end),
                truth=tuple(at[-1].tolist()),
                leg=number,
            )
            due += 1.0 / scanner.rate
        clock = float(times[-1])


def sensor_times(times: Array, poses: Array, at: Array) -> Array:
    """Return poses (m, 3) at times `at` (m,) [s] of a track (n, 3)."""
    headings = np.unwrap(poses[:, 2])
    columns = [np.interp(at, times, column) for column in (poses[:, 0], poses[:, 1], headings)]
    return np.column_stack(columns)


def _drive(path: Array, heading: float | None, reverse: bool) -> Array:
    """Return the poses (n, 3) of a robot that follows a path, one per tick."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    along = np.concatenate((np.zeros(1), np.cumsum(steps)))
    x, y = path[0].tolist()
    sign = -1.0 if reverse else 1.0
    if heading is None:
        later = min(len(path) - 1, 5)
        heading = math.atan2(path[later, 1] - y, path[later, 0] - x)
        heading += math.pi if reverse else 0.0
    theta, speed, rate, done = heading, 0.0, 0.0, 0.0
    track = [(x, y, theta)]
    end = float(along[-1])
    while done < end - 0.02 and len(track) < 10_000_000:
        # The nearest point of the next piece of the path, and the point to steer to.
        ahead = np.linspace(done, min(end, done + 0.3), 13)
        px, py = np.interp(ahead, along, path[:, 0]), np.interp(ahead, along, path[:, 1])
        done = float(ahead[int(np.argmin(np.hypot(px - x, py - y)))])
        goal = min(end, done + _AHEAD_M)
        gx = float(np.interp(goal, along, path[:, 0]))
        gy = float(np.interp(goal, along, path[:, 1]))
        bearing = math.atan2(sign * (gy - y), sign * (gx - x)) - theta
        bearing = (bearing + math.pi) % (2 * math.pi) - math.pi
        wanted = 0.0 if abs(bearing) > 0.7 else _SPEED * math.cos(bearing)
        if goal == end and math.hypot(gx - x, gy - y) < 0.05:
            done = end
        wanted_rate = max(-_TURN_RATE, min(_TURN_RATE, 2.5 * bearing))
        speed += max(-_ACCELERATION * _TICK_S, min(_ACCELERATION * _TICK_S, wanted - speed))
        rate += max(-_SPIN * _TICK_S, min(_SPIN * _TICK_S, wanted_rate - rate))
        theta += rate * _TICK_S
        x += sign * speed * _TICK_S * math.cos(theta)
        y += sign * speed * _TICK_S * math.sin(theta)
        track.append((x, y, theta))
    result = np.array(track)
    result[:, 2] = wrap_all(result[:, 2])
    return result
