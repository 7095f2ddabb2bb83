"""Correlative matching: the best poses of a point cloud in a window of a map.

Branch and bound over a pyramid of likelihood grids (Olson 2009; Hess et al. 2016), best first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from heapq import heappop, heappush

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose, wrap

Array = NDArray[np.float64]

CELL_M = 0.1
"""Size of the grid's cells, and standard deviation of a point's distance to the map [m]."""

REACH_M = 15.0
"""Points farther than this are not searched for, nor is a window wider on each side [m]."""

_LEVELS = 6  # the coarsest cells are 2^5 times larger: 3.2 m
# Points farther from the map than so many cells are not of it. Poses that differ by less than that,
# or by as many of the turns that are tried, are one peak of the likelihood.
_NEAR = 4
# A search that has expanded so many nodes, a tenth of a second, ends without a result: the
# window is too ambiguous.
_MOST_NODES = 100_000


@dataclass(frozen=True)
class Peak:
    """A local maximum: pose of the cloud in the map, and its score from 0 to 1."""

    pose: Pose
    score: float


class CorrelationMap:
    """A grid of the likelihood that a point lies at a position, with coarser upper bounds."""

    def __init__(self, points: Array) -> None:
        """Make the grid of a map's points (n, 2) [m]."""
        margin = (1 << (_LEVELS - 1)) + 4
        low = np.floor(points.min(axis=0) / CELL_M).astype(int) - margin
        high = np.floor(points.max(axis=0) / CELL_M).astype(int) + margin
        columns, rows = (high - low + 1).tolist()
        free = np.ones((rows, columns), np.uint8)
        cells = np.floor(points / CELL_M).astype(int) - low
        free[cells[:, 1], cells[:, 0]] = 0
        distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_5)
        levels = np.empty((_LEVELS, rows, columns), np.float32)
        levels[0] = np.exp(-0.5 * distance**2)
        levels[0][distance > _NEAR] = 0.0
        for level in range(1, _LEVELS):
            half = 1 << (level - 1)
            finer, coarser = levels[level - 1], levels[level]
            coarser[:] = finer
            np.maximum(coarser[:-half], finer[half:], out=coarser[:-half])
            np.maximum(coarser[:, :-half], coarser[:, half:].copy(), out=coarser[:, :-half])
        self._levels = levels
        self._origin = low * CELL_M

    def search(
        self,
        points: Array,
        center: Pose,
        reach: float,
        turn: float,
        least: float,
        most: int = 1,
        share: float = 0.8,
    ) -> list[Peak]:
        """Return the best poses of the points (n, 2) [m], the best one first.

        Args:
            points: of the cloud, in its own frame.
            center: the middle of the window.
            reach: half of the window's side [m].
            turn: half of its range of headings [rad]; pi for all.
            least: scores below this count as none.
            most: largest number of peaks.
            share: scores below this share of the best one count as none.

        Returns:
            The peaks of the likelihood whose score is at least `least` and `share` times the best
            one. Empty if none is found; `most` times the best one if
            others remained unknown because the search would have taken too long.

        """
        # From one heading to the next, the points move by a cell.
        far = math.sqrt(float(np.square(points).sum()) / len(points))
        between = CELL_M / max(CELL_M, far)
        steps = min(math.ceil(turn / between), math.ceil(math.pi / between) - 1)
        turns = np.asarray(center[2] + between * np.arange(-steps, steps + 1), np.float64)
        found = _search(
            np.ascontiguousarray(points), turns, self._levels, self._origin,
            center[0], center[1], math.ceil(reach / CELL_M), least, most, share, between,
        )  # fmt: skip
        return [
            Peak((float(x), float(y), wrap(float(theta))), float(score))
            for x, y, theta, score in found
        ]


@compiled()
def _score(
    level: NDArray[np.float32], rows: int, columns: int, cells: NDArray[np.int64], dx: int, dy: int
) -> float:
    total = 0.0
    for i in range(len(cells)):
        column, row = cells[i, 0] + dx, cells[i, 1] + dy
        if 0 <= column < columns and 0 <= row < rows:
            total += level[row, column]
    return total / len(cells)


@compiled(
    "float64[:, ::1](float64[:, ::1], float64[::1], float32[:, :, ::1], float64[::1],"
    " float64, float64, int64, float64, int64, float64, float64)"
)
def _search(
    points: Array,
    turns: Array,
    levels: NDArray[np.float32],
    origin: Array,
    x: float,
    y: float,
    reach: int,
    least: float,
    most: int,
    share: float,
    between: float,
) -> Array:
    count, rotations = len(points), len(turns)
    height, rows, columns = levels.shape
    cells = np.empty((rotations, count, 2), np.int64)
    for j in range(rotations):
        cosine, sine = math.cos(turns[j]), math.sin(turns[j])
        for i in range(count):
            px = x + cosine * points[i, 0] - sine * points[i, 1]
            py = y + sine * points[i, 0] + cosine * points[i, 1]
            cells[j, i, 0] = np.int64(math.floor((px - origin[0]) / CELL_M))
            cells[j, i, 1] = np.int64(math.floor((py - origin[1]) / CELL_M))
    top = 0
    while top < height - 1 and (1 << (top + 1)) <= 2 * reach + 1:
        top += 1
    size = 1 << top
    heap = [(0.0, top, 0, -reach, -reach)]
    heap.pop()
    for j in range(rotations):
        for dy in range(-reach, reach + 1, size):
            for dx in range(-reach, reach + 1, size):
                score = _score(levels[top], rows, columns, cells[j], dx, dy)
                if score >= least:
                    heappush(heap, (-score, top, j, dx, dy))
    found = np.empty((most, 4))
    peaks, nodes, floor = 0, 0, least
    while len(heap) > 0:
        negative, level, j, dx, dy = heappop(heap)
        if -negative < floor:
            break
        # Not within a peak, nor a coarse cell that lies within it.
        known = False
        for k in range(peaks):
            near_x = abs(x + dx * CELL_M - found[k, 0])
            near_y = abs(y + dy * CELL_M - found[k, 1])
            turned = abs((turns[j] - found[k, 2] + math.pi) % (2.0 * math.pi) - math.pi)
            span = ((1 << level) - 1) * CELL_M
            if max(near_x, near_y) + span < _NEAR * CELL_M and turned < _NEAR * between:
                known = True
                break
        if known:
            continue
        if level == 0:
            found[peaks, 0], found[peaks, 1] = x + dx * CELL_M, y + dy * CELL_M
            found[peaks, 2], found[peaks, 3] = turns[j], -negative
            peaks += 1
            if peaks == most:
                break
            floor = max(least, share * found[0, 3])
            continue
        nodes += 1
        if nodes > _MOST_NODES:
            if peaks == 0:
                break
            # What was not searched may be as good.
            found[1:] = found[0]
            peaks = most
            break
        half = 1 << (level - 1)
        for step_y in range(2):
            for step_x in range(2):
                next_x, next_y = dx + step_x * half, dy + step_y * half
                if next_x > reach or next_y > reach:
                    continue
                score = _score(levels[level - 1], rows, columns, cells[j], next_x, next_y)
                if score >= floor:
                    heappush(heap, (-score, level - 1, j, next_x, next_y))
    return found[:peaks].copy()
