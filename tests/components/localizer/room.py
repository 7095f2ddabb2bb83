"""A furnished room, its grid map, and a robot that scans it, for tests of the localizer."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import FREE, OCCUPIED, Frame, Grid, OccupancyCells
from cairn.planar.poses import Pose, compose, wrap

RESOLUTION = 0.05
Box = tuple[float, float, float, float]  # left, bottom, right, top [m]
ROOM: tuple[Box, ...] = ((1.0, 5.0, 2.2, 5.6), (4.0, 3.0, 5.5, 3.6), (7.2, 0.0, 9.0, 1.2))
STEP_S = 0.1


def room(boxes: tuple[Box, ...] = ROOM, width: float = 9.0, height: float = 7.0) -> OccupancyCells:
    """The map of a walled room with boxes in it."""
    cells = np.full((round(height / RESOLUTION), round(width / RESOLUTION)), FREE, np.int8)
    cells[0] = cells[-1] = OCCUPIED
    cells[:, 0] = cells[:, -1] = OCCUPIED
    for left, bottom, right, top in boxes:
        cells[
            round(bottom / RESOLUTION) : round(top / RESOLUTION),
            round(left / RESOLUTION) : round(right / RESOLUTION),
        ] = OCCUPIED
    return Grid(cells, Frame(RESOLUTION))


def scanned(
    grid: OccupancyCells,
    pose: Pose,
    random: np.random.Generator,
    field_of_view: float = math.radians(240),
    beams: int = 120,
    reach: float = 5.6,
    noise: float = 0.01,
) -> NDArray[np.float64]:
    """End points (m, 2) [m, base frame] of a scan: steps of 1 cm until a cell is occupied."""
    angles = np.linspace(-field_of_view / 2, field_of_view / 2, beams)
    return beam_ends(grid, pose, angles, random, reach, noise)


def beam_ends(
    grid: OccupancyCells,
    pose: Pose,
    angles: NDArray[np.float64],
    random: np.random.Generator,
    reach: float,
    noise: float,
) -> NDArray[np.float64]:
    """End points (m, 2) [m, base frame] of the beams that hit an occupied cell within reach [m]."""
    ranges = np.arange(0.0, reach, 0.01)
    x = pose[0] + np.cos(pose[2] + angles)[:, None] * ranges
    y = pose[1] + np.sin(pose[2] + angles)[:, None] * ranges
    rows, columns = grid.values.shape
    row = np.clip((y / RESOLUTION).astype(int), 0, rows - 1)
    column = np.clip((x / RESOLUTION).astype(int), 0, columns - 1)
    inside = grid.values[row, column] == OCCUPIED
    hit = inside.any(axis=1)
    far = ranges[inside.argmax(axis=1)] + noise * random.standard_normal(angles.size)
    ends = np.column_stack((far * np.cos(angles), far * np.sin(angles)))
    points: NDArray[np.float64] = ends[hit]
    return points


@dataclass(frozen=True)
class Moment:
    """Time [s], the true pose, the pose of odometry, and a scan."""

    time: float
    pose: Pose
    odometry: Pose
    points: NDArray[np.float64]


def drive(
    grid: OccupancyCells,
    start: Pose,
    seconds: float,
    seed: int = 0,
    turning: float = 0.3,
    scale: float = 1.01,
    speed: float = 0.4,
) -> Iterator[Moment]:
    """Yield the drive of a robot that turns away from obstacles; odometry is scaled by `scale`."""
    random = np.random.default_rng(seed)
    pose, odometry = start, (0.0, 0.0, 0.0)
    for k in range(round(seconds / STEP_S)):
        points = scanned(grid, pose, random)
        yield Moment(k * STEP_S, pose, odometry, points)
        ahead = points[(np.abs(points[:, 1]) < 0.35) & (points[:, 0] > 0)]
        blocked = len(ahead) > 0 and float(ahead[:, 0].min()) < 0.8
        far = 0.0 if blocked else speed * STEP_S
        turn = (0.8 if blocked else turning * math.sin(0.2 * k * STEP_S)) * STEP_S
        far_done = far * (1 + 0.02 * random.standard_normal())
        turn_done = turn * (1 + 0.03 * random.standard_normal()) + (
            0.001 * random.standard_normal() if far else 0.0
        )
        pose = compose(pose, (far_done, 0.0, turn_done))
        odometry = compose(odometry, (scale * far, 0.0, turn))


def apart(a: Pose, b: Pose) -> tuple[float, float]:
    """Distance [m] and turn [rad] between two poses."""
    return math.hypot(a[0] - b[0], a[1] - b[1]), abs(wrap(a[2] - b[2]))
