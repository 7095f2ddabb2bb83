"""Courses for simulated recordings: a world, and the tour that the robot drives in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from cairn.components.simulation.survey import grid_of_world
from cairn.components.simulation.world_file import WorldFile, read_world
from cairn.deployment.shipped import FOLDER
from cairn.planar.grid import FREE, OccupancyCells
from cairn.planar.shortest_path import CLOSED, MAX_COST, MIN_COST, PathSearch, open_costs

Point = tuple[float, float]

_CELL = 0.1  # of the grid on which tours are planned [m]
# The tour keeps this far from walls [m], and avoids them up to that distance [m].
_RADIUS_M, _AWAY_M = 0.3, 0.7
_CORRIDOR_M, _DOOR_M = 2.0, 0.9


@dataclass(frozen=True)
class Course:
    """A world, and the positions x, y [m] that the robot visits in it."""

    world: WorldFile
    stops: tuple[Point, ...]


def shipped(name: str, spacing: float = 3.0) -> Course:
    """Return a tour that visits a shipped world everywhere, returns, and sees a part again."""
    world = read_world(FOLDER / "worlds" / f"{name}.yaml")
    start = (world.robot.x, world.robot.y)
    stops = visit_all(world, spacing)
    return Course(world, (start, *stops, start, *stops[: len(stops) // 3], start))


def ring(rooms: int = 5, turns: float = 1.25) -> Course:
    """Return a square corridor with equal rooms at equal distances on its outer side.

    Each side has `rooms` rooms 10 m apart: five make a circumference of 200 m. A quarter turn maps
    it to itself. The robot drives around it, more than once, and looks into every third room.
    """
    pitch, room = 10.0, (5.0, 4.0)
    side = rooms * pitch
    half, outer = side / 2, side / 2 + _CORRIDOR_M
    lines: list[list[Point]] = []
    stops: list[Point] = []
    for quarter in range(4):
        angle = quarter * math.pi / 2
        cosine, sine = round(math.cos(angle)), round(math.sin(angle))

        def placed(x: float, y: float, c: int = cosine, s: int = sine) -> Point:
            return (c * x - s * y, s * x + c * y)

        lines.append([placed(-half, -half), placed(half, -half)])
        edge = -outer
        for number in range(rooms):
            middle = -half + (number + 0.5) * pitch
            left, right = middle - _DOOR_M / 2, middle + _DOOR_M / 2
            lines.append([placed(edge, -outer), placed(left, -outer)])
            edge = right
            west, east = middle - room[0] / 2, middle + room[0] / 2
            south = -outer - room[1]
            box = [(west, -outer), (west, south), (east, south), (east, -outer)]
            lines.append([placed(*corner) for corner in box])
            lane = -half - _CORRIDOR_M / 2
            stops.append(placed(middle, lane))
            if number % 3 == 1:
                stops += [placed(middle, -outer - 1.5), placed(middle, lane)]
        lines.append([placed(edge, -outer), placed(outer, -outer)])
        stops.append(placed(half + _CORRIDOR_M / 2, -half - _CORRIDOR_M / 2))
    count = len(stops)
    order = [stops[k % count] for k in range(math.ceil(turns * count) + 1)]
    return Course(_world(lines, order[0]), tuple(order))


def corridor(length: float = 60.0, spacing: float = 12.0) -> Course:
    """Return a straight corridor whose only features are doors, 0.1 m deep; driven there and back.

    A scanner with a short range sees neither end from the middle.
    """
    upper = _CORRIDOR_M
    lines: list[list[Point]] = [[(0.0, upper), (0.0, 0.0)], [(length, 0.0), (length, upper)]]
    for y, depth, first in ((0.0, -0.1, spacing / 2), (upper, 0.1, spacing)):
        line: list[Point] = [(0.0, y)]
        x = first
        while x + _DOOR_M < length:
            line += [(x, y), (x, y + depth), (x + _DOOR_M, y + depth), (x + _DOOR_M, y)]
            x += spacing
        lines.append([*line, (length, y)])
    near, far = (1.0, 0.9), (length - 1.0, 1.1)
    return Course(_world(lines, near), (near, far, near, far))


def large_hall(width: float = 36.0, depth: float = 28.0) -> Course:
    """Return an empty hall that is wider than the range of a scanner, but for some pillars.

    The robot drives along the walls, then across the middle.
    """
    lines = [_box(0.0, 0.0, width, depth)]
    for x, y in ((9.0, 9.0), (27.0, 8.0), (10.0, 20.0), (25.0, 19.0)):
        lines.append(_box(x - 0.3, y - 0.3, x + 0.3, y + 0.3))
    # What stands along the walls.
    for x in (4.0, 11.0, 13.5, 22.0, 31.0):
        lines.append(_box(x, 0.0, x + 1.2, 0.5))
        lines.append(_box(width - x - 0.7, depth - 0.6, width - x, depth))
    for y in (5.0, 8.0, 17.0):
        lines.append(_box(0.0, y, 0.5, y + 1.4))
        lines.append(_box(width - 0.6, depth - y, width, depth - y + 1.0))
    m = 2.5
    corners = [(m, m), (width - m, m), (width - m, depth - m), (m, depth - m)]
    stops = (*corners, corners[0], corners[2], corners[1], corners[3], corners[0])
    return Course(_world(lines, corners[0]), stops)


def open_hall() -> Course:
    """Return a hall of 30 m by 20 m with six pillars and bare walls; driven around and across."""
    width, depth, margin = 30.0, 20.0, 2.0
    lines = [_box(0.0, 0.0, width, depth)]
    pillars = [(x, y) for x in (7.5, 15.0, 22.5) for y in (6.5, 13.5)]
    lines += [_box(x - 0.25, y - 0.25, x + 0.25, y + 0.25) for x, y in pillars]
    right, upper = width - margin, depth - margin
    corners = [(margin, margin), (right, margin), (right, upper), (margin, upper)]
    stops = (*corners, corners[0], corners[2], corners[1], corners[3], corners[0])
    return Course(_world(lines, corners[0]), stops)


def two_wings(seed: int = 1) -> Course:
    """Return an office of two wings at a right angle, with rooms of different sizes and furniture.

    The robot visits every room in the first wing, then those of the second one, and returns.
    """
    random = np.random.default_rng(seed)
    lines: list[list[Point]] = []
    length, width = 30.0, _CORRIDOR_M
    rooms: list[Point] = []

    def wing(turned: bool) -> None:
        def placed(x: float, y: float) -> Point:
            return (width - y, x) if turned else (x, y)

        for lower in (True, False):
            # In the corner of the wings only the outer side has rooms.
            inner = lower if turned else not lower
            wall, away = (0.0, -1.0) if lower else (width, 1.0)
            # The rooms in the inner corner belong to neither wing.
            edge: list[Point] = [placed(width if inner else 0.0, wall)]
            x = width + 5.5 if inner else 0.0
            while x < length - 0.1:
                size = float(random.uniform(3.0, 6.0))
                if length - x - size < 3.0:
                    size = length - x
                depth = 4.0 if not inner else float(random.uniform(3.5, 5.0))
                door = x + float(random.uniform(0.3, size - _DOOR_M - 0.3))
                lines.append([*edge, placed(door, wall)])
                edge = [placed(door + _DOOR_M, wall)]
                box = [
                    placed(x, wall),
                    placed(x, wall + away * depth),
                    placed(x + size, wall + away * depth),
                    placed(x + size, wall),
                ]
                lines.append(box)
                for _ in range(int(random.integers(1, 4))):
                    w, d = random.uniform(0.4, 1.4), random.uniform(0.3, 0.8)
                    fx = x + float(random.uniform(0.2, max(0.3, size - w - 0.2)))
                    fy = wall + away * (depth - float(random.uniform(0.0, 0.8)) - float(d))
                    low, high = placed(fx, fy), placed(fx + float(w), fy + away * float(d))
                    lines.append(_box(*low, *high))
                rooms.append(placed(door + _DOOR_M / 2, wall - away * 1.0))
                rooms.append(placed(door + _DOOR_M / 2, wall + away * 1.1))
                rooms.append(placed(door + _DOOR_M / 2, wall - away * 1.0))
                x += size
            lines.append([*edge, placed(length, wall)])
        lines.append([placed(length, 0.0), placed(length, width)])

    wing(False)
    wing(True)
    # The rooms of a wing in the order of their doors.
    half = len([one for one in rooms if one[0] > one[1]])
    start = (width / 2, width / 2)
    first = _by_door(rooms[:half], 0)
    second = _by_door(rooms[half:], 1)
    return Course(_world(lines, start), (start, *first, start, *second, start, first[0], first[-1]))


def visit_all(world: WorldFile, spacing: float) -> tuple[Point, ...]:
    """Return positions `spacing` [m] apart that cover what the robot reaches, in a short order."""
    grid, costs = _planning_grid(world)
    rows, columns = costs.shape[0] - 4, costs.shape[1] - 4
    inner = costs[2:-2, 2:-2]
    search = PathSearch(costs.shape)
    step = round(spacing / _CELL)
    here = grid.frame.cell(world.robot.x, world.robot.y)
    stops = []
    for row in range(0, rows, step):
        for column in range(0, columns, step):
            block = inner[row : row + step, column : column + step]
            best = np.unravel_index(int(block.argmin()), block.shape)
            cell = (row + int(best[0]), column + int(best[1]))
            if inner[cell] < CLOSED and search.find(costs, here, cell).cells is not None:
                stops.append(cell)
    order: list[Point] = []
    while stops:
        near = sorted(stops, key=lambda cell: math.dist(cell, here))[:5]
        paths = [search.find(costs, here, cell).cells for cell in near]
        lengths = [math.inf if path is None else len(path) for path in paths]
        here = near[int(np.argmin(lengths))]
        stops.remove(here)
        order.append(_center(grid, here))
    return tuple(order)


def path_through(world: WorldFile, stops: Sequence[Point]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the path x, y (n, 2) [m] from stop to stop; `ValueError` if there is none."""
    grid, costs = _planning_grid(world)
    search = PathSearch(costs.shape)
    points = [stops[0]]
    for begin, end in pairwise(stops):
        cells = search.find(costs, grid.frame.cell(*begin), grid.frame.cell(*end)).cells
        if cells is None:
            raise ValueError(f"there is no path from {begin} to {end}")
        points += [_center(grid, (int(row), int(column))) for row, column in cells[1:]]
    return np.array(points)


def _planning_grid(world: WorldFile) -> tuple[OccupancyCells, Any]:
    grid = grid_of_world(world, _CELL)
    free = (grid.values == FREE).astype(np.uint8)
    away = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_5) * _CELL
    costs = open_costs(*free.shape)
    near = np.clip((_AWAY_M - away) / (_AWAY_M - _RADIUS_M), 0.0, 1.0)
    inner = MIN_COST + near * (MAX_COST - MIN_COST) * 0.5
    costs[2:-2, 2:-2] = np.where(away < _RADIUS_M, 255, inner.astype(np.uint8))
    return grid, costs


def _center(grid: OccupancyCells, cell: tuple[int, int]) -> Point:
    return grid.frame.point(*cell)


def _by_door(rooms: list[Point], axis: int) -> list[Point]:
    triples = [rooms[k : k + 3] for k in range(0, len(rooms), 3)]
    return [one for triple in sorted(triples, key=lambda t: t[0][axis]) for one in triple]


def _box(x1: float, y1: float, x2: float, y2: float) -> list[Point]:
    return [(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)]


def _world(lines: list[list[Point]], start: Point) -> WorldFile:
    return WorldFile.model_validate(
        {
            "walls": [{"points": [list(point) for point in line]} for line in lines],
            "robot": {"x": start[0], "y": start[1], "theta": 0.0},
        }
    )
