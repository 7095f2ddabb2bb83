"""The localizer alone, on a robot that drives at random through a random floor plan."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.config import LocalizationSettings, MeasuredBase
from cairn.components.localizer.localization import Localization
from cairn.components.localizer.odometry import MeasuredTrack
from cairn.planar.grid import FREE, OCCUPIED, Frame, Grid, OccupancyCells, distance_field
from cairn.planar.poses import Pose, compose, wrap
from tests.components.localizer.room import RESOLUTION, beam_ends

Array = NDArray[np.float64]

MODEL = MeasuredBase().model()
START: Pose = (2.0, 2.0, 0.4)


def floor(size_m: float, boxes: int, seed: int) -> OccupancyCells:
    """Return a walled square with random boxes; its first corner with `START` stays free."""
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
    grid: OccupancyCells, pose: Pose, beams: int, random: np.random.Generator, longest: float = 10.0
) -> Array:
    """Return end points (m, 2) [m] in the base frame of a full turn of beams, with 1 cm noise."""
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False)
    return beam_ends(grid, pose, angles, random, reach=longest, noise=0.01)


def wander(
    robot: Localization, grid: OccupancyCells, start: Pose, seconds: float, seed: int
) -> tuple[Array, Array, bool]:
    """Drive where there is free space, with odometry 1 % too long, 10 scans a second of 120 beams.

    Returns the errors (n, 3) [m, m, rad] and covariances (n, 3, 3) of the estimates since the robot
    is located, and whether the last one is correct within 0.3 m.
    """
    random = np.random.default_rng(seed)
    pose, odometry = start, (0.0, 0.0, 0.0)
    errors, covariances = [], []
    for k in range(round(10 * seconds)):
        points = scan(grid, pose, 120, random)
        robot.add_odometry(0.1 * k, odometry, 0.0, 0.0)
        robot.fuse_scan(0.1 * k, points)
        if robot.located:
            estimate = robot.pose()
            x, y, theta = estimate.mean
            errors.append((x - pose[0], y - pose[1], wrap(theta - pose[2])))
            covariances.append(estimate.covariance)
        ahead = points[(np.abs(points[:, 1]) < 0.35) & (points[:, 0] > 0)]
        blocked = len(ahead) > 0 and float(ahead[:, 0].min()) < 0.8
        forward, turn = (0.0, 0.08) if blocked else (0.05, 0.02 * math.sin(0.02 * k))
        slip = 1.0 + 0.02 * random.standard_normal()
        pose = compose(pose, (forward * slip, 0.0, turn * slip + 0.001 * random.standard_normal()))
        odometry = compose(odometry, (1.01 * forward, 0.0, turn))
    correct = bool(errors) and math.hypot(*errors[-1][:2]) < 0.3
    return np.array(errors).reshape(-1, 3), np.array(covariances).reshape(-1, 3, 3), correct


def new_robot(grid: OccupancyCells, seed: int) -> Localization:
    """Return a localizer with the default parameters."""
    settings = LocalizationSettings(particles=500, motion=MODEL)
    robot = Localization(settings, MeasuredTrack(), np.random.default_rng(seed))
    robot.set_grid(grid)
    return robot


def free_pose(grid: OccupancyCells, random: np.random.Generator) -> Pose:
    """Return a random pose at least 0.5 m from all obstacles."""
    clearance = distance_field(np.asarray(grid.values == OCCUPIED), RESOLUTION)
    row, column = random.choice(np.argwhere(clearance > 0.5))
    return (*grid.frame.point(int(row), int(column)), float(random.uniform(-math.pi, math.pi)))
