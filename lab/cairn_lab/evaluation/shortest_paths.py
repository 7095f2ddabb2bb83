"""Lengths of the shortest collision-free paths in a simulated world, by a visibility graph.

The reference for the planner under evaluation: it works on the world's shapes and shares no code
with the planner. A shortest path of a round robot runs straight between corners of the obstacles
grown by its radius (Lozano-Perez and Wesley, 1979).
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import shortest_path

Point = tuple[float, float]
_Array = NDArray[np.float64]

# Paths may touch obstacles: the grown obstacles are shrunk by this much [m].
_TOUCH_M = 1e-6
# Segments per quarter circle. They are chords, so a path is too short by 0.1 % around a corner.
_QUARTER_SEGMENTS = 12


class ShortestPaths:
    """Paths of a round robot of `radius` [m] among wall segments (m, 4) x1, y1, x2, y2 [m]."""

    def __init__(self, segments: _Array, radius: float) -> None:
        self._obstacles = shapely.union_all(shapely.linestrings(segments.reshape(-1, 2, 2)))
        grown = self._obstacles.buffer(radius, quad_segs=_QUARTER_SEGMENTS)
        self._grown = grown.buffer(-_TOUCH_M)
        self._corners, self._before, self._after = _convex_corners(grown)
        shapely.prepare(self._obstacles)
        shapely.prepare(self._grown)
        count = len(self._corners)
        lengths = np.full((count, count), math.inf)
        for index in range(count):
            lengths[index, index + 1 :] = self._straight_lengths(
                self._corners[index], first=index + 1, corner=index
            )
        self._distances = shortest_path(lengths, directed=False)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x, least y, greatest x, greatest y [m] of all obstacles."""
        left, bottom, right, top = self._obstacles.bounds
        return float(left), float(bottom), float(right), float(top)

    def clearance(self, point: Point) -> float:
        """Return the distance [m] from a point to the nearest obstacle."""
        return float(self._obstacles.distance(shapely.Point(point)))

    def length(self, start: Point, goal: Point) -> float:
        """Return the length [m] of the shortest path; infinite if there is none."""
        straight = shapely.LineString([start, goal])
        if not self._grown.intersects(straight):
            return float(straight.length)
        first = self._straight_lengths(np.array(start), first=0, corner=None)
        last = self._straight_lengths(np.array(goal), first=0, corner=None)
        reached = np.isfinite(first)
        return float(
            np.min(first[reached, None] + self._distances[reached] + last, initial=math.inf)
        )

    def _straight_lengths(self, point: _Array, first: int, corner: int | None) -> _Array:
        """Return lengths [m] of straight lines from a point to the corners from `first` on.

        Infinite where an obstacle is in between, or where no shortest path would continue around
        the corner. `corner` is the index of the point itself if it is a corner.
        """
        ends = self._corners[first:]
        tangent = _is_tangent(ends - point, self._before[first:], self._after[first:])
        if corner is not None:
            tangent &= _is_tangent(ends - point, self._before[corner], self._after[corner])
        lengths = np.full(len(ends), math.inf)
        chosen = np.flatnonzero(tangent)
        lines = np.stack((np.broadcast_to(point, (len(chosen), 2)), ends[chosen]), axis=1)
        free = chosen[~shapely.intersects(self._grown, shapely.linestrings(lines))]
        lengths[free] = np.hypot(*(ends[free] - point).T)
        return lengths


def _convex_corners(grown: shapely.Geometry) -> tuple[_Array, _Array, _Array]:
    """Return the convex corners (n, 2), and the sides before and after each."""
    corners, before, after = [], [], []
    for part in shapely.get_parts(grown):
        part = shapely.orient_polygons(part)  # the obstacle is to the left of each side
        for ring in (part.exterior, *part.interiors):
            points = np.array(ring.coords)[:-1]
            coming, going = points - np.roll(points, 1, 0), np.roll(points, -1, 0) - points
            convex = _cross(coming, going) > 0
            corners.append(points[convex])
            before.append(coming[convex])
            after.append(going[convex])
    return np.concatenate(corners), np.concatenate(before), np.concatenate(after)


def _is_tangent(line: _Array, before: _Array, after: _Array) -> NDArray[np.bool_]:
    """Return whether lines only touch corners with these sides, so that a path may bend there."""
    return _cross(line, before) * _cross(line, after) <= 0


def _cross(a: _Array, b: _Array) -> _Array:
    product: _Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
