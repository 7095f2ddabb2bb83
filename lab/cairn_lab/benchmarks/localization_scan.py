"""Localization by scans: time of an update, rebuilding of fields, relocalization, and accuracy.

Times are medians of one thread, measured alternately with plain numpy in one run, so that the speed
of the machine cancels out.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.components.localizer.particle_set import ParticleSet
from cairn.planar.grid import OCCUPIED, distance_field
from cairn.planar.motion_model import OdometryStep, move_pose
from cairn_lab.benchmarks.result import Metric
from cairn_lab.evaluation.results import SIGMA_LIMITS
from tests.components.localizer.random_floor import (
    MODEL,
    START,
    floor,
    free_pose,
    new_robot,
    scan,
    wander,
)
from tests.components.localizer.room import RESOLUTION

Array = NDArray[np.float64]

STEP = OdometryStep(0.12, 0.0, 0.08, 0.2)
_ROUNDS = 80


def plain_sensor_step(field: LikelihoodField, poses: Array, points: Array) -> Array:
    """Compute the same sum in numpy: float32, in chunks that fit into the cache."""
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
    """Medians [ms] of a whole update and of numpy's sensor step, of their ratio, and the share of
    updates that resampled.
    """

    whole: float
    plain: float
    ratio: float
    resampled: float


def updates(particles: int, beams: int, seed: int = 0) -> Times:
    """Time both alternately while a robot drives around and is tracked."""
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

        # The second one finds the field in the cache: alternate.
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


def timed(call: Callable[[], None]) -> float:
    """Return the duration of a call [s]."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def rebuilding() -> tuple[float, float]:
    """Return median times [ms] of the distance and the likelihood field of 600 x 600 cells."""
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


def global_tries(tries: int) -> tuple[int, int]:
    """Return how many robots in 30 x 30 m are located within 20 s: correctly, and wrongly."""
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


def tracking(runs: int) -> tuple[Array, Array]:
    """Return position errors (n,) [m] and squared Mahalanobis distances (n,) from a known start."""
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


def measure() -> list[Metric]:
    """Return all metrics."""
    metrics = []
    for particles, beams, limit in ((2_000, 60, 0.7), (10_000, 360, 0.35)):
        t = updates(particles, beams)
        metrics.append(
            Metric(f"one update, {particles} poses x {beams} beams: times numpy's sensor step",
                   t.ratio, "", at_most=limit, note=f"{t.whole:.2f} ms; numpy {t.plain:.2f} ms; "
                   f"{t.resampled:.0%} of the updates resampled")
        )  # fmt: skip
    distance, likelihood = rebuilding()
    metrics += [
        Metric("distance field of 600 x 600 cells", distance, "ms", at_most=4.0),
        Metric("likelihood field of 600 x 600 cells, rebuilt", likelihood, "ms", at_most=4.0),
    ]
    right, wrong = global_tries(30)
    metrics += [
        Metric("located anywhere in 30 x 30 m, of 30 tries", right, "", at_least=27),
        Metric("located at a wrong pose, of 30 tries", wrong, "", at_most=1),
    ]
    errors, squares = tracking(5)
    metrics.append(
        Metric("tracking at cells of 5 cm: position error", float(np.sqrt(np.mean(errors**2))),
               "m rms", at_most=0.02, note=f"95 % {np.percentile(errors, 95):.3f} m")
    )  # fmt: skip
    one, two, three = (float(np.mean(squares <= limit)) for limit in SIGMA_LIMITS)
    metrics.append(
        Metric("truth within 1 sigma as stated", one, "of poses", at_least=0.55,
               note=f"within 2: {two:.3f}, 3: {three:.3f}")
    )  # fmt: skip
    return metrics
