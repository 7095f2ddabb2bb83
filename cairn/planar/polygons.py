"""Polygons in the plane: which cells and points they cover, and whether their edges cross.

A polygon is given by its edges (n, 4) [m], x and y of both ends, of its outline and its holes. A
point is inside if a ray from it crosses an odd number of edges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.grid import Frame

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]


def edges_of(points: Array, rings: NDArray[np.uint32], *, closed: bool = True) -> Array:
    """Return the edges (n, 4) of rings of points (m, 2); `rings` are their numbers of points.

    With `closed` each ring's last point is joined to its first one.
    """
    parts: list[Array] = []
    for bounds in ring_bounds(rings):
        ring = points[bounds]
        ends = np.roll(ring, -1, axis=0) if closed else ring[1:]
        parts.append(np.hstack((ring[: len(ends)], ends)))
    return np.ascontiguousarray(np.vstack(parts)) if parts else np.empty((0, 4))


def ring_bounds(rings: NDArray[np.uint32]) -> Iterator[slice]:
    """Yield which points each ring has."""
    first = 0
    for count in rings.tolist():
        yield slice(first, first + count)
        first += count


def is_inside(edges: Array, x: float, y: float) -> bool:
    """Return whether a point is inside a polygon."""
    return bool(_is_inside(edges, x, y))


def distance_to_edges(edges: Array, x: float, y: float) -> float:
    """Return the distance [m] of a point to the nearest edge; infinite without edges."""
    return float(_distance(edges, x, y))


def points_near(edges: Array, x: float, y: float, reach: float, spacing: float) -> Array:
    """Return points (n, 2) on the edges within `reach` [m] of a position, `spacing` [m] apart."""
    return np.array(_points_near(edges, x, y, reach, spacing))


def covered_cells(edges: Array, frame: Frame, shape: tuple[int, int]) -> Cells:
    """Return which cells of a grid a polygon touches: those inside, and those on its edges."""
    in_cells = _in_cells(edges, frame)
    cells = np.zeros(shape, np.bool_)
    _fill(in_cells, cells)
    _mark_edges(in_cells, cells)
    return cells


def inside_cells(edges: Array, frame: Frame, shape: tuple[int, int]) -> Cells:
    """Return the cells of a grid of which the centers are inside a polygon."""
    cells = np.zeros(shape, np.bool_)
    _fill(_in_cells(edges, frame), cells)
    return cells


def cells_along(line: Array, half_width: float, frame: Frame, shape: tuple[int, int]) -> Cells:
    """Return the cells of a grid of which the centers are within `half_width` [m] of a line."""
    cells = np.zeros(shape, np.bool_)
    _mark_along(_in_cells(line, frame), half_width / frame.resolution, cells)
    return cells


def crossing(edges: Array) -> tuple[float, float] | None:
    """Return a point [m] at which two edges cross, or touch beside a shared end; None without.

    Edges that follow one another may share an end, and no more.
    """
    found = _crossing(edges)
    return None if math.isnan(found[0]) else (float(found[0]), float(found[1]))


def _in_cells(edges: Array, frame: Frame) -> Array:
    ox, oy, theta = frame.origin
    cosine, sine = math.cos(theta), math.sin(theta)
    dx, dy = edges[:, 0::2] - ox, edges[:, 1::2] - oy
    result = np.empty_like(edges)
    result[:, 0::2] = (cosine * dx + sine * dy) / frame.resolution
    result[:, 1::2] = (cosine * dy - sine * dx) / frame.resolution
    return result


@compiled()
def _segment_distance(x0: float, y0: float, x1: float, y1: float, x: float, y: float) -> float:
    dx, dy = x1 - x0, y1 - y0
    squared = dx * dx + dy * dy
    share = 0.0
    if squared > 0.0:
        share = min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / squared))
    return math.hypot(x0 + share * dx - x, y0 + share * dy - y)


@compiled("boolean(float64[:,::1], float64, float64)")
def _is_inside(edges: Array, x: float, y: float) -> bool:
    inside = False
    for i in range(edges.shape[0]):
        x0, y0, x1, y1 = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
            inside = not inside
    return inside


@compiled("float64(float64[:,::1], float64, float64)")
def _distance(edges: Array, x: float, y: float) -> float:
    least = math.inf
    for i in range(edges.shape[0]):
        apart = _segment_distance(edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3], x, y)
        least = min(least, apart)
    return least


@compiled("float64[:,::1](float64[:,::1], float64, float64, float64, float64)")
def _points_near(edges: Array, x: float, y: float, reach: float, spacing: float) -> Array:
    count, room = 0, 256
    points = np.empty((room, 2))
    for i in range(edges.shape[0]):
        x0, y0 = edges[i, 0], edges[i, 1]
        dx, dy = edges[i, 2] - x0, edges[i, 3] - y0
        length = math.hypot(dx, dy)
        if length == 0.0:
            continue
        ux, uy = dx / length, dy / length
        middle = (x - x0) * ux + (y - y0) * uy
        across = (x - x0) * uy - (y - y0) * ux
        if abs(across) > reach:
            continue
        half = math.sqrt(reach * reach - across * across)
        first, last = max(0.0, middle - half), min(length, middle + half)
        if first > last:
            continue
        steps = math.ceil((last - first) / spacing)
        for k in range(steps + 1):
            along = first + (last - first) * k / max(1, steps)
            if count == room:
                room *= 2
                larger = np.empty((room, 2))
                larger[:count] = points
                points = larger
            points[count, 0], points[count, 1] = x0 + along * ux, y0 + along * uy
            count += 1
    return points[:count].copy()


@compiled("void(float64[:,::1], boolean[:,::1])")
def _fill(edges: Array, cells: Cells) -> None:
    """Set the cells of which the centers are inside; edges are in cells."""
    rows, columns = cells.shape
    toggles = np.zeros((rows, columns + 1), np.bool_)
    for i in range(edges.shape[0]):
        x0, y0, x1, y1 = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        low, high = min(y0, y1), max(y0, y1)
        for row in range(max(0, math.floor(low - 0.5)), min(rows, math.ceil(high + 0.5))):
            y = row + 0.5
            if (y0 > y) == (y1 > y):
                continue
            # Centers left of the crossing have one more crossing on their right.
            column = math.ceil(x0 + (y - y0) / (y1 - y0) * (x1 - x0) - 0.5)
            toggles[row, 0] = not toggles[row, 0]
            column = min(columns, max(0, column))
            toggles[row, column] = not toggles[row, column]
    for row in range(rows):
        inside = False
        for column in range(columns):
            if toggles[row, column]:
                inside = not inside
            if inside:
                cells[row, column] = True


@compiled("void(float64[:,::1], boolean[:,::1])")
def _mark_edges(edges: Array, cells: Cells) -> None:
    """Set the cells that an edge touches; edges are in cells."""
    rows, columns = cells.shape
    for i in range(edges.shape[0]):
        x0, y0, x1, y1 = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        for row in range(max(0, math.floor(y0)), min(rows, math.floor(y1) + 1)):
            if y1 > y0:
                a = x0 + (max(float(row), y0) - y0) / (y1 - y0) * (x1 - x0)
                b = x0 + (min(float(row + 1), y1) - y0) / (y1 - y0) * (x1 - x0)
            else:
                a, b = x0, x1
            left, right = math.floor(min(a, b)), math.floor(max(a, b))
            for column in range(max(0, left), min(columns, right + 1)):
                cells[row, column] = True


@compiled("void(float64[:,::1], float64, boolean[:,::1])")
def _mark_along(edges: Array, half: float, cells: Cells) -> None:
    rows, columns = cells.shape
    for i in range(edges.shape[0]):
        x0, y0, x1, y1 = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        for row in range(
            max(0, math.floor(min(y0, y1) - half)), min(rows, math.ceil(max(y0, y1) + half))
        ):
            # Only the part of the line that is within reach of this row.
            y = row + 0.5
            left, right = min(x0, x1), max(x0, x1)
            if abs(y1 - y0) > 1e-9:
                a = x0 + (min(max(y - half, min(y0, y1)), max(y0, y1)) - y0) / (y1 - y0) * (x1 - x0)
                b = x0 + (min(max(y + half, min(y0, y1)), max(y0, y1)) - y0) / (y1 - y0) * (x1 - x0)
                left, right = min(a, b), max(a, b)
            for column in range(
                max(0, math.floor(left - half)), min(columns, math.ceil(right + half))
            ):
                if _segment_distance(x0, y0, x1, y1, column + 0.5, y) <= half:
                    cells[row, column] = True


@compiled("UniTuple(float64, 2)(float64[:,::1])")
def _crossing(edges: Array) -> tuple[float, float]:
    count = edges.shape[0]
    for i in range(count):
        ax, ay, bx, by = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        for j in range(i + 1, count):
            cx, cy, dx, dy = edges[j, 0], edges[j, 1], edges[j, 2], edges[j, 3]
            if max(cx, dx) < min(ax, bx) or min(cx, dx) > max(ax, bx):
                continue
            if max(cy, dy) < min(ay, by) or min(cy, dy) > max(ay, by):
                continue
            follows = bx == cx and by == cy
            precedes = dx == ax and dy == ay
            if follows or precedes:
                # They share an end; they must not lie upon one another.
                if follows and precedes:
                    return ax, ay
                px, py = (ax, ay) if follows else (bx, by)
                qx, qy = (dx, dy) if follows else (cx, cy)
                sx, sy = (bx, by) if follows else (ax, ay)
                cross = (px - sx) * (qy - sy) - (py - sy) * (qx - sx)
                same = (px - sx) * (qx - sx) + (py - sy) * (qy - sy)
                if cross == 0.0 and same >= 0.0:
                    return sx, sy
                continue
            c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
            a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
            b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
            if ((c <= 0.0 <= d) or (d <= 0.0 <= c)) and ((a <= 0.0 <= b) or (b <= 0.0 <= a)):
                share = a / (a - b) if a != b else 0.0
                return ax + share * (bx - ax), ay + share * (by - ay)
    return math.nan, math.nan
