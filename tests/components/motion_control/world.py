"""A small world of walls and round people, and a robot in it, for tests of motion control."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cairn.components.motion_control.behaviors import (
    Behavior,
    BehaviorInput,
    BehaviorResult,
    MotionState,
)
from cairn.components.motion_control.followed_path import FollowedPath
from cairn.components.motion_control.local_planner import OBSTACLE_RANGE_M
from cairn.components.motion_control.moving_obstacles import MovingObstacleTracker
from cairn.components.motion_control.scan_memory import ScanMemory
from cairn.components.motion_control.velocity_limits import CommandLimiter, MotionLimits
from cairn.planar.poses import Pose, compose, relative, wrap
from cairn.planar.scans import Rays

Array = NDArray[np.float64]
Wall = tuple[float, float, float, float]
Disc = tuple[float, float, float]

RADIUS = 0.22
LIMITS = MotionLimits(
    radius=RADIUS,
    margin=0.05,
    stop_distance=0.12,
    full_speed_clearance=0.2,
    speed=0.6,
    creep_speed=0.15,
    turn_speed=1.5,
    acceleration=0.8,
    turn_acceleration=3.0,
    braking=0.6,
    turn_braking=2.0,
    latency=0.15,
    lookahead=1.2,
)


def box(x: float, y: float, width: float, height: float) -> list[Wall]:
    """The four walls of a box around its center."""
    a, b, c, d = x - width / 2, x + width / 2, y - height / 2, y + height / 2
    return [(a, c, b, c), (b, c, b, d), (b, d, a, d), (a, d, a, c)]


@dataclass
class World:
    """Walls and discs; discs may move with time [s]."""

    walls: list[Wall] = field(default_factory=list)
    discs: Callable[[float], Sequence[Disc]] = lambda _: ()

    def ranges(self, time: float, scanner: Pose, angles: Array, noise: Array) -> Array:
        """The range [m] of each beam, +inf beyond 10 m."""
        x, y, theta = scanner
        ux, uy = np.cos(theta + angles)[:, None], np.sin(theta + angles)[:, None]
        best = np.full(angles.size, np.inf)
        if self.walls:
            walls = np.array(self.walls)
            ax, ay = walls[:, 0] - x, walls[:, 1] - y
            wx, wy = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
            with np.errstate(all="ignore"):
                cross = ux * wy - uy * wx
                t = (ax * wy - ay * wx) / cross
                s = (ax * uy - ay * ux) / cross
                hits = np.where((t > 0) & (s >= 0) & (s <= 1), t, np.inf)
            best = hits.min(axis=1)
        for cx, cy, r in self.discs(time):
            along = (cx - x) * ux[:, 0] + (cy - y) * uy[:, 0]
            across = (cy - y) * ux[:, 0] - (cx - x) * uy[:, 0]
            with np.errstate(invalid="ignore"):
                t = along - np.sqrt(r * r - across * across)
            best = np.fmin(best, np.where(t > 0, t, np.inf))
        best = best + noise
        best[best > 10.0] = np.inf
        return best

    def distance(self, time: float, x: float, y: float) -> float:
        """The distance [m] of a point to the nearest thing."""
        least = math.inf
        for x0, y0, x1, y1 in self.walls:
            length2 = (x1 - x0) ** 2 + (y1 - y0) ** 2
            t = min(1.0, max(0.0, ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length2))
            least = min(least, math.hypot(x - x0 - t * (x1 - x0), y - y0 - t * (y1 - y0)))
        for cx, cy, r in self.discs(time):
            least = min(least, math.hypot(x - cx, y - cy) - r)
        return least


@dataclass
class Robot:
    """A differential drive with limited accelerations; its odometry drifts a little."""

    pose: Pose
    speed: float = 0.0
    turn: float = 0.0
    odom: Pose = (5.0, -3.0, 1.0)
    drift: float = 1.01

    def move(self, command: tuple[float, float], seconds: float) -> None:
        """Follow a command for that time [s]."""
        for desired, name, most in (
            (command[0], "speed", 0.8 * seconds),
            (command[1], "turn", 3.0 * seconds),
        ):
            now = getattr(self, name)
            setattr(self, name, now + min(most, max(-most, desired - now)))
        angle = self.turn * seconds
        distance = self.speed * seconds
        step = (distance * math.cos(angle / 2), distance * math.sin(angle / 2), angle)
        self.pose = compose(self.pose, step)
        self.odom = compose(self.odom, (step[0] * self.drift, step[1] * self.drift, angle))


@dataclass
class Record:
    """The record of a drive."""

    times: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    turns: list[float] = field(default_factory=list)
    states: list[MotionState] = field(default_factory=list)
    results: list[BehaviorResult] = field(default_factory=list)
    clearance: float = math.inf
    moving_clearance: float = math.inf


def drive(
    world: World,
    robot: Robot,
    behavior: Behavior,
    seconds: float,
    *,
    seed: int = 0,
    beams: int = 360,
    view: float = 2 * math.pi,
    noise: float = 0.01,
    pose_noise: float = 0.01,
    until: MotionState | None = MotionState.DONE,
    limits: MotionLimits = LIMITS,
) -> Record:
    """Let a behavior drive: scans at 10 Hz, odometry at 50 Hz, and commands."""
    random = np.random.default_rng(seed)
    memory = ScanMemory(3_000_000_000, limits.radius)
    movers = MovingObstacleTracker()
    limiter = CommandLimiter(limits)
    record = Record()
    whole = view > 2 * math.pi - 1e-6
    angles = np.linspace(-view / 2, view / 2, beams, endpoint=not whole)
    command = (0.0, 0.0)
    believed = robot.pose
    base = robot.odom
    ended = 0
    for tick in range(round(seconds * 50)):
        time = tick * 0.02
        now = round(time * 1e9) + 1_000_000_000
        scans = tick % 5 == 0
        if scans:
            ranges = world.ranges(time, robot.pose, angles, random.normal(0, noise, beams))
            rays = rays_from(robot.odom, angles, ranges)
            memory.add(now, robot.odom, rays)
            memory.set_predictions(movers.add_scan(now, rays, robot.turn))
            x, y, theta = robot.pose
            dx, dy, angle = random.normal(0, pose_noise, 3)
            believed, base = (x + dx, y + dy, wrap(theta + angle)), robot.odom
        if scans or tick % 5 == 3:
            inputs = BehaviorInput(
                now,
                robot.odom,
                robot.speed,
                robot.turn,
                compose(believed, relative(base, robot.odom)),
                memory,
                memory.around(robot.odom, OBSTACLE_RANGE_M, robot.speed, limits.speed),
                (0.0, view / 2),
            )
            result = behavior.step(inputs)
            command = limiter.command(
                result.target, now, (robot.speed, robot.turn), inputs.obstacles
            )
            record.results.append(result)
            record.states.append(result.state)
        robot.move(command, 0.02)
        apart = world.distance(time + 0.02, *robot.pose[:2])
        record.clearance = min(record.clearance, apart - limits.radius)
        if abs(robot.speed) > 0.02:
            record.moving_clearance = min(record.moving_clearance, apart - limits.radius)
        record.times.append(time)
        record.poses.append(robot.pose)
        record.speeds.append(robot.speed)
        record.turns.append(robot.turn)
        ended = ended + 1 if until is not None and record.states[-1] is until else 0
        if ended > 10:
            break
    return record


def rays_from(at: Pose, angles: Array, ranges: Array) -> Rays:
    """The rays of a scanner at the robot's center that stands at a pose."""
    starts = np.tile(np.array(at[:2], np.float64), (ranges.size, 1))
    return Rays(starts, at[2] + angles, ranges, 10.0)


def route(*points: tuple[float, float], heading: float = 0.0) -> FollowedPath:
    """A path of straight lines through these points, the last one with that heading."""
    poses = np.array([(x, y, 0.0) for x, y in points])
    return FollowedPath(poses, (*points[-1], heading))
