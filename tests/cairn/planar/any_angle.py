"""The shortest any-angle path over small grids by brute force, the reference of the tests."""

import heapq
import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cairn.planar.shortest_path import MARGIN, MIN_COST, CellCosts

Cell = tuple[int, int]


def clear(
    closed: NDArray[np.bool_], a: NDArray[np.float64], b: NDArray[np.float64], rim: float = 0.0
) -> bool:
    """Whether the segment from a to b (column, row) [cells] touches no closed cell.

    Nor its rim, or what of it is more than `rim` [cells] inside.
    """
    rows, columns = np.nonzero(closed)
    low = np.stack((columns, rows)) + rim
    high = np.stack((columns, rows)) + 1.0 - rim
    enter, leave = np.zeros(rows.size), np.ones(rows.size)
    missed = np.zeros(rows.size, np.bool_)
    for axis in range(2):
        step = b[axis] - a[axis]
        if abs(step) < 1e-12:
            missed |= (a[axis] < low[axis] - 1e-9) | (a[axis] > high[axis] + 1e-9)
            continue
        one, other = (low[axis] - a[axis]) / step, (high[axis] - a[axis]) / step
        enter = np.maximum(enter, np.minimum(one, other))
        leave = np.minimum(leave, np.maximum(one, other))
    return bool(np.all(missed | (enter > leave + 1e-9)))


def cost_along(prices: CellCosts, points: NDArray[np.float64]) -> float:
    """Cost of a polyline of points (column, row) [cells], in cells of the least price."""
    total = 0.0
    for a, b in pairwise(points):
        crossings = [np.array([0.0, 1.0])]
        for low, high, step in zip(np.minimum(a, b), np.maximum(a, b), b - a, strict=True):
            lines = np.arange(math.ceil(low), math.floor(high) + 1)
            if step != 0.0:
                crossings.append((lines - (low if step > 0 else high)) / step)
        shares = np.unique(np.concatenate(crossings))
        middles = a + (shares[:-1, None] + np.diff(shares)[:, None] / 2) * (b - a)
        columns, rows = np.floor(middles).astype(int).T + MARGIN
        total += math.dist(a, b) * float(np.diff(shares) @ prices[rows, columns]) / MIN_COST
    return total


def shortest(closed: NDArray[np.bool_], start: Cell, goal: Cell) -> float:
    """Length [cells] of the shortest path between the centers of two cells past closed ones.

    Infinite without a path. It turns at corners of closed cells, a thousandth of a cell off.
    """
    places = [np.array([column + 0.5, row + 0.5]) for row, column in (start, goal)]
    places += _corners(closed)
    best = {0: 0.0}
    done: set[int] = set()
    queue = [(0.0, 0)]
    while queue:
        length, here = heapq.heappop(queue)
        if here == 1:
            return length
        if here in done:
            continue
        done.add(here)
        for there in range(len(places)):
            step = math.dist(places[here], places[there])
            if length + step < best.get(there, math.inf) and clear(
                closed, places[here], places[there]
            ):
                best[there] = length + step
                heapq.heappush(queue, (length + step, there))
    return math.inf


def _corners(closed: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    rows, columns = closed.shape
    corners = []
    for row in range(1, rows):
        for column in range(1, columns):
            around = closed[row - 1 : row + 1, column - 1 : column + 1]
            if around.sum() == 1:
                down, right = np.argwhere(around)[0]
                off = 1e-3 * np.array([1 - 2 * right, 1 - 2 * down])
                corners.append(np.array([column, row]) + off)
    return corners
