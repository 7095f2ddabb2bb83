"""Shorten and smooth a path over a cost grid: pull it taut, resample it, round its corners.

Points are (n, 2) columns and rows in cells from the grid's corner, as `Frame.cells` returns them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.shortest_path import CLOSED, MARGIN, MIN_COST, CellCosts

Points = NDArray[np.float64]

# Rounds of cutting corners, the least gain of a cut [cells], and the bisections for its position.
# Twice as many rounds or bisections make paths through random clutter cheaper by under 0.002 %.
_ROUNDS, _GAIN, _HALVINGS = 6, 1e-3, 5
# Rounds in which each point moves toward the middle of its neighbors.
_SMOOTHING_ROUNDS = 12


def cell_centers(cells: NDArray[np.int64]) -> Points:
    """Return the centers of cells, which have rows and columns (n, 2)."""
    return cells[:, ::-1].astype(np.float64) + 0.5


def first_closed_segment(grid: CellCosts, points: Points, closed: int = CLOSED) -> int:
    """Return the index of the first segment that touches a cell of at least the cost `closed`.

    Everything outside the grid is closed. -1 if there is no such segment.
    """
    return int(_first_closed(grid.reshape(-1), grid.shape[1], _owned(points), closed))


def path_cost(grid: CellCosts, points: Points, closed: int = CLOSED) -> float:
    """Return the cost of the polyline in free cells; infinite if it touches a `closed` cell.

    Everything outside the grid is closed.
    """
    return float(_cost(grid.reshape(-1), grid.shape[1], _owned(points), closed))


def pull_taut(grid: CellCosts, points: Points) -> Points:
    """Return the polyline pulled taut between its ends: no more expensive, over no closed cell.

    It passes obstacles on the same sides. `points` must touch no closed cell.
    """
    result: Points = _taut(grid.reshape(-1), grid.shape[1], _owned(points))
    return result


def resampled(grid: CellCosts, points: Points, step: float) -> Points:
    """Return points on the polyline at most `step` cells apart, corners rounded where possible."""
    result: Points = _resampled(grid.reshape(-1), grid.shape[1], _owned(points), step)
    return result


def _owned(points: Points) -> Points:
    return np.ascontiguousarray(points, np.float64)


@compiled()
def _along(
    grid: CellCosts, stride: int, x0: float, y0: float, x1: float, y1: float, closed: int
) -> float:
    """Return the cost of a straight line in free cells; infinite over a closed cell.

    Both ends must be on the grid.
    """
    dx, dy = x1 - x0, y1 - y0
    column, row = math.floor(x0) + MARGIN, math.floor(y0) + MARGIN
    columns = abs(math.floor(x1) + MARGIN - column)
    rows = abs(math.floor(y1) + MARGIN - row)
    cell = row * stride + column
    price = float(grid[cell])
    if price >= closed:
        return math.inf
    right, down = (1 if dx > 0 else -1), (stride if dy > 0 else -stride)
    each_x = abs(1.0 / dx) if columns > 0 else math.inf
    each_y = abs(1.0 / dy) if rows > 0 else math.inf
    next_x, next_y = math.inf, math.inf
    if columns > 0:
        next_x = abs((column - MARGIN + (1 if dx > 0 else 0) - x0) / dx)
    if rows > 0:
        next_y = abs((row - MARGIN + (1 if dy > 0 else 0) - y0) / dy)
    done, total = 0.0, 0.0
    while columns + rows > 0:
        reached = min(next_x, next_y)
        total += (reached - done) * price
        done = reached
        if abs(next_x - next_y) < 1e-9:  # through a corner, where both cells beside it are touched
            if grid[cell + right] >= closed or grid[cell + down] >= closed:
                return math.inf
            cell += right + down
            next_x += each_x
            next_y += each_y
            columns -= 1
            rows -= 1
        elif next_x < next_y:
            cell += right
            next_x += each_x
            columns -= 1
        else:
            cell += down
            next_y += each_y
            rows -= 1
        if columns == 0:
            next_x = math.inf
        if rows == 0:
            next_y = math.inf
        price = float(grid[cell])
        if price >= closed:
            return math.inf
    total += max(0.0, 1.0 - done) * price
    return total * math.hypot(dx, dy) / MIN_COST


@compiled()
def _on_grid(grid: CellCosts, stride: int, x: float, y: float) -> bool:
    rows, columns = grid.size // stride - 2 * MARGIN, stride - 2 * MARGIN
    return 0 <= x < columns and 0 <= y < rows


@compiled("int64(uint8[::1], int64, float64[:,::1], int64)")
def _first_closed(grid: CellCosts, stride: int, points: Points, closed: int) -> int:
    for i in range(len(points) - 1):
        x0, y0, x1, y1 = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
        on_grid = _on_grid(grid, stride, x0, y0) and _on_grid(grid, stride, x1, y1)
        if not on_grid or _along(grid, stride, x0, y0, x1, y1, closed) == math.inf:
            return i
    return -1


@compiled("float64(uint8[::1], int64, float64[:,::1], int64)")
def _cost(grid: CellCosts, stride: int, points: Points, closed: int) -> float:
    total = 0.0
    for i in range(len(points) - 1):
        x0, y0, x1, y1 = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
        if not (_on_grid(grid, stride, x0, y0) and _on_grid(grid, stride, x1, y1)):
            return math.inf
        total += _along(grid, stride, x0, y0, x1, y1, closed)
    return total


@compiled()
def _drop(grid: CellCosts, stride: int, line: Points, costs: Points, count: int) -> int:
    """Drop each point that a straight line bypasses at no more cost, every second one per round."""
    before = count + 1
    while count < before:
        before = count
        kept, i = 0, 0
        while i < before - 1:
            line[kept] = line[i]
            costs[kept] = costs[i]
            kept += 1
            if i + 2 < before:
                direct = _along(grid, stride, line[i, 0], line[i, 1], line[i + 2, 0],
                             line[i + 2, 1], CLOSED)  # fmt: skip
                if direct <= costs[i + 1] + costs[i + 2] + 1e-9:
                    costs[i + 2] = direct
                    i += 2
                    continue
            i += 1
        line[kept] = line[before - 1]
        costs[kept] = costs[before - 1]
        count = kept + 1
    return count


@compiled()
def _cut(
    grid: CellCosts,
    stride: int,
    line: Points,
    costs: Points,
    count: int,
    wider: Points,
    wider_costs: Points,
) -> int:
    """Cut every corner as far as that is cheaper; return the size of the new polyline."""
    wider[0] = line[0]
    size = 1
    for i in range(1, count - 1):
        x, y = line[i, 0], line[i, 1]
        ax, ay = wider[size - 1, 0] - x, wider[size - 1, 1] - y
        bx, by = line[i + 1, 0] - x, line[i + 1, 1] - y
        share, good, half = 0.5, 0.0, 0.25
        best = 0.0
        to, on = 0.0, 0.0
        for _ in range(_HALVINGS):
            px, py, qx, qy = x + share * ax, y + share * ay, x + share * bx, y + share * by
            here = _along(grid, stride, px, py, x, y, CLOSED)
            there = _along(grid, stride, x, y, qx, qy, CLOSED)
            across = _along(grid, stride, px, py, qx, qy, CLOSED)
            if here + there - across > max(best, _GAIN):
                best, good, to, on = here + there - across, share, across, here
            share += half if good == share else -half
            half *= 0.5
        if good == 0.0:
            wider[size, 0], wider[size, 1] = x, y
            wider_costs[size] = costs[i]
            size += 1
            continue
        wider[size, 0], wider[size, 1] = x + good * ax, y + good * ay
        wider_costs[size] = max(0.0, costs[i] - on)
        wider[size + 1, 0], wider[size + 1, 1] = x + good * bx, y + good * by
        wider_costs[size + 1] = to
        costs[i + 1] = _along(grid, stride, wider[size + 1, 0], wider[size + 1, 1],
                              line[i + 1, 0], line[i + 1, 1], CLOSED)  # fmt: skip
        size += 2
    wider[size] = line[count - 1]
    wider_costs[size] = costs[count - 1]
    return size + 1


@compiled("float64[:,::1](uint8[::1], int64, float64[:,::1])")
def _taut(grid: CellCosts, stride: int, points: Points) -> Points:
    """Drop corners and cut them alternately until neither is cheaper."""
    line = points.copy()
    costs = np.empty(len(line))  # of the segment that ends in each point
    for i in range(1, len(line)):
        costs[i] = _along(grid, stride, line[i - 1, 0], line[i - 1, 1], line[i, 0], line[i, 1],
                          CLOSED)  # fmt: skip
    count = _drop(grid, stride, line, costs, len(line))
    for _ in range(_ROUNDS):
        wider = np.empty((2 * count, 2))
        prices_of = np.empty(2 * count)
        size = _cut(grid, stride, line, costs, count, wider, prices_of)
        line, costs = wider, prices_of
        if size == count:
            break
        count = _drop(grid, stride, line, costs, size)
    return line[:count].copy()


@compiled("float64[:,::1](uint8[::1], int64, float64[:,::1], float64)")
def _resampled(grid: CellCosts, stride: int, points: Points, step: float) -> Points:
    count = 1
    for i in range(len(points) - 1):
        length = math.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
        count += max(1, math.ceil(length / step - 1e-9))
    line = np.empty((count, 2))
    size = 0
    for i in range(len(points) - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        parts = max(1, math.ceil(math.hypot(dx, dy) / step - 1e-9))
        for k in range(parts):
            line[size, 0] = points[i, 0] + dx * k / parts
            line[size, 1] = points[i, 1] + dy * k / parts
            size += 1
    line[size] = points[len(points) - 1]
    for _ in range(_SMOOTHING_ROUNDS):
        for i in range(1, count - 1):
            x = 0.25 * (line[i - 1, 0] + line[i + 1, 0]) + 0.5 * line[i, 0]
            y = 0.25 * (line[i - 1, 1] + line[i + 1, 1]) + 0.5 * line[i, 1]
            if abs(x - line[i, 0]) + abs(y - line[i, 1]) < 0.002:
                continue
            if _along(grid, stride, line[i - 1, 0], line[i - 1, 1], x, y, CLOSED) == math.inf:
                continue
            if _along(grid, stride, x, y, line[i + 1, 0], line[i + 1, 1], CLOSED) == math.inf:
                continue
            line[i, 0], line[i, 1] = x, y
    return line
