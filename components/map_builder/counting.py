"""Builds a grid map from scans whose poses are known, all at once: as from a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from components.map_builder.ray_walk import first_step
from planar.compiled import compiled
from planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid, OccupancyCells
from planar.poses import Pose
from planar.scans import beams_of
from schemas.sensor_msgs import LaserScan

# From this share of the rays that reached a cell on, it is occupied if they ended there.
_OCCUPIED_SHARE = 0.3
# Empty cells around what was seen [m].
_BORDER_M = 1.0


def build_map(
    posed_scans: Iterable[tuple[Pose, LaserScan]], resolution: float, mount: Pose, reach: float
) -> OccupancyCells:
    """The map that scans from known poses draw: cells of `resolution` [m].

    Of the rays that reached a cell the share that ended there tells whether it is occupied (the
    counting model: Haehnel, Burgard, Thrun 2003). Rays longer than `reach` [m] count as
    passing only. Raises `ValueError` if there is no scan.
    """
    segments = [
        _segments(pose, scan, mount, min(reach, scan.range_max)) for pose, scan in posed_scans
    ]
    if not segments:
        raise ValueError("there is no scan with a pose")
    starts = np.concatenate([s for s, _, _ in segments])
    ends = np.concatenate([e for _, e, _ in segments])
    hit = np.concatenate([h for _, _, h in segments])
    least = np.minimum(starts.min(axis=0), ends.min(axis=0)) - _BORDER_M
    most = np.maximum(starts.max(axis=0), ends.max(axis=0)) + _BORDER_M
    columns, rows = np.ceil((most - least) / resolution).astype(int)
    ended = np.zeros((rows, columns), np.int32)
    passed = np.zeros((rows, columns), np.int32)
    _count((starts - least) / resolution, (ends - least) / resolution, hit, ended, passed)
    cells = np.full((rows, columns), UNKNOWN, np.int8)
    reached = ended + passed
    cells[reached > 0] = FREE
    cells[(ended > 0) & (ended >= _OCCUPIED_SHARE * reached)] = OCCUPIED
    return Grid(cells, Frame(resolution, (float(least[0]), float(least[1]), 0.0)))


def _segments(
    pose: Pose, scan: LaserScan, mount: Pose, reach: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    beams = beams_of(scan, mount)
    told = ~np.isnan(beams.ranges)
    ranges, angles = beams.ranges[told], beams.angles[told] + pose[2]
    hit = ranges <= reach
    length = np.where(hit, ranges, reach)
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    start = np.array(
        [
            pose[0] + cosine * mount[0] - sine * mount[1],
            pose[1] + sine * mount[0] + cosine * mount[1],
        ]
    )
    starts = np.tile(start, (ranges.size, 1))
    ends = starts + np.column_stack((length * np.cos(angles), length * np.sin(angles)))
    return starts, ends, hit


@compiled("void(float64[:, ::1], float64[:, ::1], boolean[::1], int32[:, ::1], int32[:, ::1])")
def _count(
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    hit: NDArray[np.bool_],
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
