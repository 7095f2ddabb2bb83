"""Time and length of plans on large maps of boxes and serpentines, compared with SciPy."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from cairn.components.path_planner.cost_map import CostMap, CostParameters
from cairn.components.path_planner.planning import Planner
from cairn.planar.grid import Frame, OccupancyCells
from cairn.planar.shortest_path import CLOSED, MARGIN
from cairn_lab.benchmarks.result import Metric

RESOLUTION = 0.05
COSTS = CostParameters(
    radius=0.22,
    inflation_distance=0.45,
    inflation_weight=1.0,
    margin=0.05,
    allow_unknown=False,
)
LENGTH_ALONE = replace(COSTS, inflation_weight=0.0)
LIMITS_MS = {200: 0.5, 1000: 20.0, 4000: 350.0}
SIDES = ((0, 1), (1, 0), (1, 1), (1, -1))


def boxes(size: int, seed: int) -> OccupancyCells:
    """Return a square map with random boxes of 0.2 to 2 m on a tenth of it and free corners."""
    rng = np.random.default_rng(seed)
    values = np.zeros((size, size), np.int8)
    while (values == 100).mean() < 0.1:
        height, width = rng.integers(4, 41, 2)
        row, column = rng.integers(0, size, 2)
        values[row : row + height, column : column + width] = 100
    values[:30, :30] = values[-30:, -30:] = 0
    return OccupancyCells(values, Frame(RESOLUTION))


def serpentine(size: int) -> OccupancyCells:
    """Return corridors of 2 m, connected at alternate ends."""
    values = np.zeros((size, size), np.int8)
    for turn, row in enumerate(range(40, size - 40, 40)):
        opening = slice(40, None) if turn % 2 else slice(None, size - 40)
        values[row : row + 2, opening] = 100
    return OccupancyCells(values, Frame(RESOLUTION))


def milliseconds(call: Callable[[], object], times: int = 5) -> float:
    """Return the median duration of a call, after one that does not count."""
    call()
    taken = []
    for _ in range(times):
        began = time.perf_counter()
        call()
        taken.append(time.perf_counter() - began)
    return 1e3 * float(np.median(taken))


def planned(costs: CostMap) -> tuple[float, float]:
    """Return the time [ms] of a plan from corner to corner, and its length [m]; 0 without one."""
    planner = Planner(0.1)
    far = costs.shape[0] * RESOLUTION - 0.7
    start, goal = (0.7, 0.7, 0.0), (far, far, 0.0)
    taken = milliseconds(lambda: planner.plan(costs, start, goal))
    route = planner.plan(costs, start, goal).route
    return taken, 0.0 if route is None else route.length()


def dijkstra_ms(costs: CostMap) -> tuple[float, float]:
    """Return time [ms] and length [m] of SciPy's Dijkstra over eight neighbors of a given graph."""
    free = costs.cell_costs[MARGIN:-MARGIN, MARGIN:-MARGIN] < CLOSED
    rows, columns = free.shape
    numbers = np.arange(rows * columns).reshape(rows, columns)
    starts, ends, lengths = [], [], []
    for down, right in SIDES:
        here = np.s_[: rows - down, max(0, -right) : columns - max(0, right)]
        there = np.s_[down:, max(0, right) : columns - max(0, -right)]
        both = free[here] & free[there]
        starts.append(numbers[here][both])
        ends.append(numbers[there][both])
        lengths.append(np.full(int(both.sum()), np.hypot(down, right) * RESOLUTION))
    index: tuple[NDArray[np.int64], NDArray[np.int64]] = (
        np.concatenate(starts),
        np.concatenate(ends),
    )
    graph = coo_array((np.concatenate(lengths), index), shape=(rows * columns,) * 2).tocsr()
    edge = round(0.7 / RESOLUTION)
    start, goal = numbers[edge, edge], numbers[rows - edge, columns - edge]
    length = float(dijkstra(graph, directed=False, indices=start)[goal])
    return milliseconds(lambda: dijkstra(graph, directed=False, indices=start), 3), length


def _transform(free: NDArray[np.uint8]) -> None:
    cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def measure() -> list[Metric]:
    """Measure plans on a given cost map, on one thread, and updates of the cost map."""
    cv2.setNumThreads(1)
    metrics = []
    for size, limit in LIMITS_MS.items():
        maps = [CostMap(boxes(size, seed), COSTS) for seed in range(3 if size < 4000 else 1)]
        plans = [planned(costs) for costs in maps]
        taken = float(np.median([ms for ms, _ in plans]))
        free = (maps[0].cell_costs < CLOSED).view(np.uint8)
        transform = milliseconds(partial(_transform, free), 3)
        metrics += [
            Metric(f"{size} x {size}, boxes: plan", taken, "ms", at_most=limit,
                   note=f"{taken / transform:.2g} times one distance transform of the map"),
            Metric(f"{size} x {size}, boxes: maps without a plan",
                   float(sum(length == 0 for _, length in plans)), "", at_most=0),
        ]  # fmt: skip
        if size <= 1000:
            reference, length = dijkstra_ms(maps[0])
            metrics.append(
                Metric(f"{size} x {size}, boxes: times as fast as Dijkstra in SciPy",
                       reference / taken, "x", at_least=6, note=f"SciPy {reference:.3g} ms")
            )  # fmt: skip
            shortest = planned(CostMap(boxes(size, 0), LENGTH_ALONE))[1]
            metrics += [
                Metric(f"{size} x {size}: length, weight 0, to Dijkstra's over 8 neighbors",
                       shortest / length, "", at_most=1.0),
                Metric(f"{size} x {size}: length to that with weight 0",
                       plans[0][1] / shortest, "", at_most=1.1),
            ]  # fmt: skip
        taken, length = planned(CostMap(serpentine(size), COSTS))
        metrics.append(
            Metric(f"{size} x {size}, serpentine: plan", taken, "ms",
                   at_most=3 * limit if length else 0, note=f"{length:.0f} m long")
        )  # fmt: skip
    return metrics + cost_map_updates()


def cost_map_updates() -> list[Metric]:
    """Measure changes of 2 x 2 m, and scanned obstacles, in a map of 30 x 30 m."""
    grid = boxes(600, 1)
    costs = CostMap(grid, COSTS)
    flat = np.zeros((40, 40), np.int8)
    person = np.argwhere(np.ones((8, 2))) + 300
    turn = iter(range(10**6))
    return [
        Metric("600 x 600: a window of 40 x 40 changed",
               milliseconds(lambda: costs.update(280, 280, flat), 20), "ms", at_most=1),
        Metric("600 x 600: 16 scanned cells moved",
               milliseconds(lambda: costs.set_scanner_obstacles(person + next(turn) % 2), 20),
               "ms", at_most=0.3),
    ]  # fmt: skip
