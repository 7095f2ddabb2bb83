"""One scan's update against plain numpy, the rebuilding of fields, and how well the robot is found.

Times are medians of one thread, alternately measured in one run: the machine's own speed cancels.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from benchmarks.result import Figure
from cairn.components.localizer.config import LocalizationSettings, MeasuredBase
from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.localization import Localization
from cairn.components.localizer.odometry import MeasuredTrack, OdometryStep, move_pose
from cairn.components.localizer.particle_set import ParticleSet
from cairn.planar.grid import FREE, OCCUPIED, Frame, Grid, OccupancyCells, distance_field
from cairn.planar.poses import Pose, compose, wrap
from cairn.tools.evaluation.results import SIGMA_LIMITS

Array = NDArray[np.float64]

RESOLUTION = 0.05
MODEL = MeasuredBase().model()
STEP = OdometryStep(0.12, 0.0, 0.08, 0.2)
_ROUNDS = 80
START: Pose = (2.0, 2.0, 0.4)


def floor(size_m: float, boxes: int, seed: int) -> OccupancyCells:
    """A walled square with boxes in it, at random; its middle and its first corner stay free."""
    random = np.random.default_rng(seed)
    count = round(size_m / RESOLUTION)
    cells = np.full((count, count), FREE, np.int8)
    cells[0] = cells[-1] = OCCUPIED
    cells[:, 0] = cells[:, -1] = OCCUPIED
    for _ in range(boxes):
        rows, columns = random.integers(6, 50, 2)
        row, column = random.integers(70, count - 50, 2)
        cells[row : row + rows, column : column + columns] = OCCUPIED
    return Grid(cells, Frame(RESOLUTION))


def scan(
    grid: OccupancyCells, pose: Pose, beams: int, random: np.random.Generator, reach: float = 10.0
) -> Array:
    """End points (m, 2) [m] of a full turn of beams with 1 cm of noise, in the base's frame."""
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False)
    ranges = np.arange(0.0, reach, 0.01)
    x = pose[0] + np.cos(pose[2] + angles)[:, None] * ranges
    y = pose[1] + np.sin(pose[2] + angles)[:, None] * ranges
    rows, columns = grid.values.shape
    row = np.clip((y / RESOLUTION).astype(int), 0, rows - 1)
    column = np.clip((x / RESOLUTION).astype(int), 0, columns - 1)
    inside = grid.values[row, column] == OCCUPIED
    far = ranges[inside.argmax(axis=1)] + 0.01 * random.standard_normal(beams)
    hit = inside.any(axis=1)
    points: Array = np.column_stack((far * np.cos(angles), far * np.sin(angles)))[hit]
    return points


def plain_sensor_step(field: LikelihoodField, poses: Array, points: Array) -> Array:
    """The same sum in numpy: float32, in chunks that stay in the cache, one gather and one sum."""
    flat = field.cells.ravel()
    rows, columns = field.cells.shape
    per_meter = np.float32(1.0 / field.frame.resolution)
    x, y = (points.T * per_meter).astype(np.float32)
    total = np.empty(poses.shape[1], np.float32)
    chunk = max(1, 65_536 // len(points))
    for begin in range(0, poses.shape[1], chunk):
        part = poses[:, begin : begin + chunk].astype(np.float32)
        cosine, sine = np.cos(part[2])[:, None], np.sin(part[2])[:, None]
        column = (part[0][:, None] * per_meter + (cosine * x - sine * y)).astype(np.int32)
        row = (part[1][:, None] * per_meter + (sine * x + cosine * y)).astype(np.int32)
        column += 1
        row += 1
        np.clip(column, 0, columns - 1, out=column)
        np.clip(row, 0, rows - 1, out=row)
        row *= columns
        row += column
        total[begin : begin + chunk] = flat[row].sum(axis=1)
    return total.astype(np.float64)


@dataclass(frozen=True)
class Times:
    """Medians [ms] of a whole update and of numpy's sensor step alone, of their ratio, and the
    share of the updates that resampled.
    """

    whole: float
    plain: float
    ratio: float
    resampled: float


def updates(particles: int, beams: int, seed: int = 0) -> Times:
    """Both in turn, while a robot drives around and is tracked: all of each scan counts."""
    random = np.random.default_rng(seed)
    grid = floor(9.0, 4, seed)
    field = LikelihoodField(grid, 0.1, 0.05)
    cloud = ParticleSet(particles, particles, MODEL, random)
    cloud.set_gaussian(START, np.diag([0.05**2, 0.05**2, 0.03**2]))
    share = 0.35 * 60.0 / beams
    poses = list(accumulate(range(_ROUNDS), lambda pose, _: move_pose(pose, STEP), initial=START))
    scans = [scan(grid, pose, beams, random) for pose in poses[1:]]
    times, resampled = [], 0
    for k, points in enumerate(scans):

        def whole(points: Array = points) -> None:
            cloud.move(STEP)
            cloud.fuse(lambda poses: share * field.log_likelihood(poses, points))
            cloud.estimate()

        def plain(points: Array = points) -> None:
            plain_sensor_step(field, cloud.poses, points)

        # Who comes second finds the field in the cache: in turn.
        if k % 2:
            theirs = timed(plain)
            times.append((timed(whole), theirs))
        else:
            times.append((timed(whole), timed(plain)))
        resampled += not cloud.log_weights.any()
    taken = np.array(times[10:])
    ours_ms, theirs_ms = (1e3 * np.median(taken, axis=0)).tolist()
    ratio = float(np.median(taken[:, 0] / taken[:, 1]))
    return Times(ours_ms, theirs_ms, ratio, resampled / len(times))


def timed(what: Callable[[], None]) -> float:
    """Seconds that it takes."""
    began = time.perf_counter()
    what()
    return time.perf_counter() - began


def rebuilding() -> tuple[float, float]:
    """Median times [ms] of the distance field and of the likelihood field of 600 x 600 cells."""
    grid = floor(30.0, 60, 0)
    obstacles = np.asarray(grid.values == OCCUPIED)
    field = LikelihoodField(grid, 0.1, 0.05)

    def distance() -> None:
        distance_field(obstacles, RESOLUTION)

    def likelihood() -> None:
        field.renew(0, 0, grid.values)

    times = [(timed(distance), timed(likelihood)) for _ in range(25)]
    first, second = np.median(np.array(times[5:]), axis=0)
    return 1e3 * float(first), 1e3 * float(second)


def wander(
    robot: Localization, grid: OccupancyCells, start: Pose, seconds: float, seed: int
) -> tuple[Array, Array, bool]:
    """Drive where the way is free, with odometry off by 1 %, 10 scans a second of 120 beams.

    Gives the errors (n, 3) [m, m, rad] and covariances (n, 3, 3) of the poses since the robot is
    located, and whether the last one is right within 0.3 m.
    """
    random = np.random.default_rng(seed)
    pose, odometry = start, (0.0, 0.0, 0.0)
    errors, covariances = [], []
    for k in range(round(10 * seconds)):
        points = scan(grid, pose, 120, random)
        robot.add_odometry(0.1 * k, odometry, 0.0, 0.0)
        robot.fuse_scan(0.1 * k, points)
        if robot.located:
            known = robot.pose()
            x, y, theta = known.mean
            errors.append((x - pose[0], y - pose[1], wrap(theta - pose[2])))
            covariances.append(known.covariance)
        ahead = points[(np.abs(points[:, 1]) < 0.35) & (points[:, 0] > 0)]
        blocked = len(ahead) > 0 and float(ahead[:, 0].min()) < 0.8
        far, turn = (0.0, 0.08) if blocked else (0.05, 0.02 * math.sin(0.02 * k))
        slip = 1.0 + 0.02 * random.standard_normal()
        pose = compose(pose, (far * slip, 0.0, turn * slip + 0.001 * random.standard_normal()))
        odometry = compose(odometry, (1.01 * far, 0.0, turn))
    right = bool(errors) and math.hypot(*errors[-1][:2]) < 0.3
    return np.array(errors).reshape(-1, 3), np.array(covariances).reshape(-1, 3, 3), right


def new_robot(grid: OccupancyCells, seed: int) -> Localization:
    """A localizer with the default parameters."""
    settings = LocalizationSettings(particles=500, motion=MODEL)
    robot = Localization(settings, MeasuredTrack(), np.random.default_rng(seed))
    robot.set_grid(grid)
    return robot


def global_tries(tries: int) -> tuple[int, int]:
    """How many of so many robots, anywhere in 30 x 30 m, are found within 20 s; how many wrong."""
    right = wrong = 0
    for seed in range(tries):
        grid = floor(30.0, 60, seed % 5)
        robot = new_robot(grid, seed)
        assert robot.map is not None
        random = np.random.default_rng(1000 + seed)
        start = free_pose(grid, random)
        _, _, found = wander(robot, grid, start, 20.0, seed)
        right += found
        wrong += robot.located and not found
    return right, wrong


def free_pose(grid: OccupancyCells, random: np.random.Generator) -> Pose:
    """A pose 0.5 m from everything."""
    room = distance_field(np.asarray(grid.values == OCCUPIED), RESOLUTION)
    row, column = random.choice(np.argwhere(room > 0.5))
    return (*grid.frame.point(int(row), int(column)), float(random.uniform(-math.pi, math.pi)))


def tracking(runs: int) -> tuple[Array, Array]:
    """Position errors (n,) [m] and squared Mahalanobis distances (n,) from a known start."""
    far, distances = [], []
    for seed in range(runs):
        grid = floor(9.0, 4, seed)
        robot = new_robot(grid, seed)
        robot.set_pose(START, np.diag([0.05**2, 0.05**2, 0.03**2]))
        errors, covariances, _ = wander(robot, grid, START, 30.0, seed)
        far.append(np.hypot(errors[20:, 0], errors[20:, 1]))
        for error, covariance in zip(errors[20:, :2], covariances[20:, :2, :2], strict=True):
            distances.append(float(error @ np.linalg.solve(covariance, error)))
    return np.concatenate(far), np.array(distances)


def measure() -> list[Figure]:
    """All figures."""
    figures = []
    for particles, beams, limit in ((2_000, 60, 0.7), (10_000, 360, 0.35)):
        t = updates(particles, beams)
        figures.append(
            Figure(f"one update, {particles} poses x {beams} beams: times numpy's sensor step",
                   t.ratio, "", at_most=limit, note=f"{t.whole:.2f} ms; numpy {t.plain:.2f} ms; "
                   f"{t.resampled:.0%} of the updates resampled")
        )  # fmt: skip
    distance, likelihood = rebuilding()
    figures += [
        Figure("distance field of 600 x 600 cells", distance, "ms", at_most=4.0),
        Figure("likelihood field of 600 x 600 cells, rebuilt", likelihood, "ms", at_most=4.0),
    ]
    right, wrong = global_tries(30)
    figures += [
        Figure("found anywhere in 30 x 30 m, of 30 tries", right, "", at_least=27),
        Figure("in a wrong place, of 30 tries", wrong, "", at_most=1),
    ]
    errors, squares = tracking(5)
    figures.append(
        Figure("tracking at cells of 5 cm: position error", float(np.sqrt(np.mean(errors**2))),
               "m rms", at_most=0.02, note=f"95 % {np.percentile(errors, 95):.3f} m")
    )  # fmt: skip
    one, two, three = (float(np.mean(squares <= limit)) for limit in SIGMA_LIMITS)
    figures.append(
        Figure("truth within 1 sigma as stated", one, "of poses", at_least=0.55,
               note=f"within 2: {two:.3f}, 3: {three:.3f}")
    )  # fmt: skip
    return figures
