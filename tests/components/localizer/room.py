"""A furnished room, its grid map, and a robot that scans it, for tests of the localizer."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
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
    first = _first_occupied(
        grid.values, pose[0], pose[1], np.cos(pose[2] + angles), np.sin(pose[2] + angles), ranges
    )
    hit = first < ranges.size
    far = ranges[first % ranges.size] + noise * random.standard_normal(angles.size)
    ends = np.column_stack((far * np.cos(angles), far * np.sin(angles)))
    points: NDArray[np.float64] = ends[hit]
    return points


@compiled("i8[:](i1[:, ::1], f8, f8, f8[:], f8[:], f8[:])")
def _first_occupied(
    cells: NDArray[np.int8],
    x: float,
    y: float,
    cosines: NDArray[np.float64],
    sines: NDArray[np.float64],
    ranges: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Index of the first range of each beam that lies in an occupied cell; their number if none."""
    rows, columns = cells.shape
    first = np.full(cosines.size, ranges.size)
    for beam in range(cosines.size):
        for step in range(ranges.size):
            row = int((y + sines[beam] * ranges[step]) / RESOLUTION)
            column = int((x + cosines[beam] * ranges[step]) / RESOLUTION)
            row, column = min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)
            if cells[row, column] == OCCUPIED:
                first[beam] = step
                break
    return first


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
