"""Builds a grid map from all scans of a recording, whose poses are known."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cairn.components.map_builder.occupancy import first_step
from cairn.planar.compiled import compiled
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid, OccupancyCells
from cairn.planar.poses import Pose
from cairn.planar.scans import beams_of
from cairn.schemas.nav_msgs import MOST_CELLS
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]

# Where no other reason is given, these constants were chosen by hand; `benchmarks/constants.yaml`
# has the effect of half and double. docs/benchmarks.md has the errors of the logs fr079 and fr101
# on maps that are made so.

# A cell is occupied if at least this share of the rays that reached it ended there.
_OCCUPIED_SHARE = 0.3
# Margin of unknown cells around the map [m].
_BORDER_M = 1.0
# A surface is estimated from beams this many indices apart, if their ends are this near [m].
_NEIGHBOR, _SURFACE_M = 3, 1.0
# Least sine of the angle between a ray and a surface: smaller ones count as this.
_GRAZING = 0.1


def build_grid(
    posed_scans: Iterable[tuple[Pose, LaserScan]], resolution: float, mount: Pose, reach: float
) -> OccupancyCells:
    """Build a map with cells of `resolution` [m] from scans with known poses.

    A cell is occupied by the share of rays that ended there, among those that reached it (the
    counting model: Haehnel, Burgard, Thrun 2003). Rays longer than `reach` [m] only pass. A ray
    is not evidence about cells before its end that are within a cell's size of the surface that it
    hit: where it grazes a wall, errors of a few centimeters lead it through many cells of that
    wall. Raises `ValueError` if `scans` is empty, or the map had more than
    `MOST_CELLS`.
    """
    segments = [
        _segments(pose, scan, mount, min(reach, scan.range_max), resolution)
        for pose, scan in posed_scans
    ]
    if not segments:
        raise ValueError("it has no scan with a pose")
    starts, ends, hit, free_share = (np.concatenate(part) for part in zip(*segments, strict=True))
    least = np.minimum(starts.min(axis=0), ends.min(axis=0)) - _BORDER_M
    most = np.maximum(starts.max(axis=0), ends.max(axis=0)) + _BORDER_M
    columns, rows = np.ceil((most - least) / resolution).tolist()
    if not columns * rows <= MOST_CELLS:
        raise ValueError(
            f"its scans cover {most[0] - least[0]:g} x {most[1] - least[1]:g} m, which are "
            f"{columns * rows:g} cells of {resolution} m, more than {MOST_CELLS}"
        )
    columns, rows = int(columns), int(rows)
    ended = np.zeros((rows, columns), np.int32)
    passed = np.zeros((rows, columns), np.int32)
    _count(
        (starts - least) / resolution, (ends - least) / resolution, hit, free_share, ended, passed
    )
    cells = np.full((rows, columns), UNKNOWN, np.int8)
    reached = ended + passed
    cells[reached > 0] = FREE
    cells[(ended > 0) & (ended >= _OCCUPIED_SHARE * reached)] = OCCUPIED
    return Grid(cells, Frame(resolution, (float(least[0]), float(least[1]), 0.0)))


def _segments(
    pose: Pose, scan: LaserScan, mount: Pose, reach: float, resolution: float
) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """Return starts and ends (n, 2) [m] of the rays, and which of them hit something.

    The last array (n,) is the share of each ray up to which it says that cells are free.
    """
    beams = beams_of(scan, mount)
    valid = ~np.isnan(beams.ranges)
    ignored = resolution / _sines(beams.angles, np.where(beams.hit, beams.ranges, math.nan))
    ranges, angles = beams.ranges[valid], beams.angles[valid] + pose[2]
    hit = ranges <= reach
    length = np.where(hit, ranges, reach)
    free_share = np.where(hit, 1.0 - ignored[valid] / np.maximum(length, resolution), 1.0)
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    start = np.array(
        [
            pose[0] + cosine * mount[0] - sine * mount[1],
            pose[1] + sine * mount[0] + cosine * mount[1],
        ]
    )
    starts = np.tile(start, (ranges.size, 1))
    ends = starts + np.column_stack((length * np.cos(angles), length * np.sin(angles)))
    return starts, ends, hit, free_share


def _sines(angles: Array, ranges: Array) -> Array:
    """Return the sine (n,) of the angle between each beam and the surface it hit, 1 if unknown.

    The surface runs between the ends of beams some indices before and after.
    """
    sines = np.ones(ranges.size)
    if ranges.size <= 2 * _NEIGHBOR:
        return sines
    x, y = ranges * np.cos(angles), ranges * np.sin(angles)
    along_x = x[2 * _NEIGHBOR :] - x[: -2 * _NEIGHBOR]
    along_y = y[2 * _NEIGHBOR :] - y[: -2 * _NEIGHBOR]
    apart = np.hypot(along_x, along_y)
    middle = angles[_NEIGHBOR:-_NEIGHBOR]
    across = np.abs(along_y * np.cos(middle) - along_x * np.sin(middle))
    with np.errstate(invalid="ignore", divide="ignore"):
        inner = np.where(apart <= _SURFACE_M, np.clip(across / apart, _GRAZING, 1.0), 1.0)
    sines[_NEIGHBOR:-_NEIGHBOR] = inner
    return sines


@compiled(
    "void(float64[:, ::1], float64[:, ::1], boolean[::1], float64[::1],"
    " int32[:, ::1], int32[:, ::1])"
)
def _count(
    starts: Array,
    ends: Array,
    hit: NDArray[np.bool_],
    free_share: Array,
    ended: NDArray[np.int32],
    passed: NDArray[np.int32],
) -> None:
    for i in range(len(starts)):
        x, y = starts[i, 0], starts[i, 1]
        dx, dy = ends[i, 0] - x, ends[i, 1] - y
        column, row = math.floor(x), math.floor(y)
        last_column, last_row = math.floor(ends[i, 0]), math.floor(ends[i, 1])
        step_x, next_x, every_x = first_step(x, dx)
        step_y, next_y, every_y = first_step(y, dy)
        for _ in range(abs(last_column - column) + abs(last_row - row)):
            if min(next_x, next_y) <= free_share[i]:
                passed[row, column] += 1
            if next_x < next_y:
                next_x += every_x
                column += step_x
            else:
                next_y += every_y
                row += step_y
        if hit[i]:
            ended[last_row, last_column] += 1
        else:
            passed[last_row, last_column] += 1
