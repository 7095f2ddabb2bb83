"""Plans from a pose to a pose over a cost map, or the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cairn.components.path_planner.cost_map import BLOCKED, CostMap, nearest_open
from cairn.planar.grid import Frame
from cairn.planar.path_shape import (
    cell_centers,
    first_closed_segment,
    path_cost,
    pull_taut,
    resampled,
)
from cairn.planar.poses import Pose
from cairn.planar.shortest_path import CLOSED, MARGIN, Cell, CellCosts, PathSearch

Array = NDArray[np.float64]

# A robot that stands in an obstacle by no more than this [m] finds the way out of it.
ESCAPE_M = 0.4
# Nothing is so far off [m] that its square in cells were too large a number.
_NOWHERE_M = 1e9


class Outcome(IntEnum):
    """What came of planning; the numbers are those of the message Plan."""

    FOUND = 0
    NOT_READY = 1
    START_BLOCKED = 2
    GOAL_BLOCKED = 3
    OUTSIDE_MAP = 4
    UNREACHABLE = 5


@dataclass(frozen=True)
class Route:
    """A path: poses (n, 3) in frame map, and the same places (n, 2) in cells of a map at `frame`.

    The first `leaving` segments lead a robot that seems to stand in an obstacle out of it, the last
    `entering` ones to a goal that is too near to an obstacle to be passed.
    """

    poses: Array
    points: Array
    frame: Frame
    leaving: int
    entering: int

    def length(self, since: int = 0) -> float:
        """The way along it [m], from its pose of that number on."""
        steps = np.diff(self.poses[since:, :2], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def further(self, since: int, length: float) -> int:
        """Number of its pose that is so far [m] beyond that of number `since`, or its last one."""
        steps = np.diff(self.poses[since:, :2], axis=0)
        along = np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))
        return min(since + 1 + int(np.searchsorted(along, length)), len(self.poses) - 1)

    def cells_at(self, frame: Frame) -> Array:
        """The places (n, 2) in cells of a map that lies at `frame`.

        Taken from the poses only if they must be: rounded, a place on the edge of a cell may come
        to lie in the closed cell beside it.
        """
        if frame == self.frame:
            return self.points
        return _cells(frame, self.poses)


@dataclass(frozen=True)
class Answer:
    """A route, or why there is none and the reachable place x, y [m] nearest to the goal."""

    outcome: Outcome
    route: Route | None = None
    reason: str = ""
    nearest: tuple[float, float] | None = None


class Planner:
    """Plans over the cost map of the moment; keeps the memory that the search works in."""

    def __init__(self, step_m: float) -> None:
        self._step_m = step_m
        self._search = PathSearch((0, 0))

    def prepare(self, costs: CostMap) -> None:
        """Take the memory for plans over a map of this size."""
        if self._search.shape != costs.prices.shape:
            self._search = PathSearch(costs.prices.shape)

    def plan(self, costs: CostMap, start: Pose, goal: Pose) -> Answer:
        """A path of poses about `step_m` apart from the robot's pose to the goal's."""
        if not all(abs(value) < _NOWHERE_M for value in goal):
            return Answer(Outcome.OUTSIDE_MAP, reason=f"the goal {goal} is not a place")
        self.prepare(costs)
        begin = costs.cell(start[0], start[1])
        if begin is None:
            return Answer(
                Outcome.START_BLOCKED, reason=f"the robot at {_place(start)} is outside the map"
            )
        way_out = self._way_out(costs, start, begin)
        if isinstance(way_out, Answer):
            return way_out
        target = costs.cell(goal[0], goal[1])
        if target is None:
            return self._instead(
                costs, way_out, goal, Outcome.OUTSIDE_MAP, f"{_place(goal)} is outside the map"
            )
        way_in = self._way_in(costs, goal, target)
        if way_in is None:
            return self._instead(
                costs, way_out, goal, Outcome.GOAL_BLOCKED,
                f"{_place(goal)} {_why_closed(costs, target)}",
            )  # fmt: skip
        way = self._search.find(costs.prices, way_out, way_in)
        if way.cells is None:
            return self._unreachable(costs, way_out, start, goal, way.nearest)
        return Answer(Outcome.FOUND, self._route(costs, costs.prices, way.cells, start, goal))

    def _way_out(self, costs: CostMap, start: Pose, begin: Cell) -> Cell | Answer:
        """The cell to begin in: the robot's, or the nearest that is not closed."""
        if not _closed(costs.prices, begin):
            return begin
        column, row = costs.frame.cells(start[0], start[1])
        found = nearest_open(costs.prices, row, column)
        if found is not None and found[1] * costs.frame.resolution <= ESCAPE_M:
            return found[0]
        reason = f"the robot at {_place(start)} {_why_closed(costs, begin)}"
        if found is not None:
            place = costs.frame.point(*found[0])
            off = found[1] * costs.frame.resolution
            reason += f"; the nearest free place, {_place(place)}, is {off:.2f} m away"
        return Answer(Outcome.START_BLOCKED, reason=reason)

    def _way_in(self, costs: CostMap, goal: Pose, target: Cell) -> Cell | None:
        """The cell to end in: the goal's, or the nearest from which the robot fits up to it."""
        if not _closed(costs.prices, target):
            return target
        column, row = costs.frame.cells(goal[0], goal[1])
        found = nearest_open(costs.prices, row, column)
        if found is None or found[1] * costs.frame.resolution > ESCAPE_M:
            return None
        last = np.array([(found[0][1] + 0.5, found[0][0] + 0.5), (column, row)])
        return found[0] if first_closed_segment(costs.prices, last, BLOCKED) < 0 else None

    def _instead(
        self, costs: CostMap, begin: Cell, goal: Pose, outcome: Outcome, what: str
    ) -> Answer:
        """Where one can get instead of a goal that is no place to be."""
        column, row = costs.frame.cells(goal[0], goal[1])
        free = nearest_open(costs.prices, row, column)
        assert free is not None  # where the robot begins is open
        way = self._search.find(costs.prices, begin, free[0])
        reached = free[0] if way.cells is not None else way.nearest
        nearest = costs.frame.point(*reached)
        apart = math.hypot(nearest[0] - goal[0], nearest[1] - goal[1])
        return Answer(
            outcome,
            reason=f"the goal {what}; the nearest place that can be reached, {_place(nearest)}, "
            f"is {apart:.2f} m from it",
            nearest=nearest,
        )

    def _unreachable(
        self, costs: CostMap, begin: Cell, start: Pose, goal: Pose, reached: Cell
    ) -> Answer:
        nearest = costs.frame.point(*reached)
        apart = math.hypot(nearest[0] - goal[0], nearest[1] - goal[1])
        return Answer(
            Outcome.UNREACHABLE,
            reason=f"{self._why_unreachable(costs, begin, start, goal)} from {_place(start)} to "
            f"{_place(goal)}; the nearest place that can be reached, {_place(nearest)}, is "
            f"{apart:.2f} m from the goal",
            nearest=nearest,
        )

    def _why_unreachable(self, costs: CostMap, begin: Cell, start: Pose, goal: Pose) -> str:
        """Whether the map has no way, or which of the scanner's obstacles closes it."""
        target = self._way_in(costs, goal, costs.frame.cell(goal[0], goal[1]))
        assert target is not None  # or the goal would have been refused
        way = self._search.find(costs.map_prices, begin, target) if costs.overlaid else None
        if way is None or way.cells is None:
            return "there is no way"
        route = self._route(costs, costs.map_prices, way.cells, start, goal)
        at = first_closed_segment(costs.prices, route.points[route.leaving :]) + route.leaving
        x, y = costs.nearest_seen(*route.poses[at, :2])
        return f"blocked by what the scanner sees at {_place((x, y))}"

    def _route(
        self, costs: CostMap, prices: CellCosts, cells: NDArray[np.int64], start: Pose, goal: Pose
    ) -> Route:
        frame = costs.frame
        here, there = frame.cells(start[0], start[1]), frame.cells(goal[0], goal[1])
        leaving = _closed(prices, frame.cell(start[0], start[1]))
        entering = _closed(prices, frame.cell(goal[0], goal[1]))
        head = np.empty((0, 2)) if leaving else np.array([here])
        tail = np.empty((0, 2)) if entering else np.array([there])
        line = pull_taut(prices, np.vstack((head, cell_centers(cells), tail)))
        points = resampled(prices, line, self._step_m / frame.resolution)
        if leaving:
            points = np.vstack(([here], points))
        if entering:
            points = np.vstack((points, [there]))
        poses = np.empty((len(points), 3))
        poses[:, 0], poses[:, 1] = _places(costs, points)
        ahead = np.diff(poses[:, :2], axis=0)
        mean = ahead.copy()
        mean[1:] += ahead[:-1]
        poses[:-1, 2] = np.arctan2(mean[:, 1], mean[:, 0])
        poses[0, :2] = start[:2]
        poses[-1] = goal
        return Route(poses, points, frame, int(leaving), int(entering))


def remaining(route: Route, pose: Pose) -> tuple[int, float]:
    """Number of the route's pose nearest to the robot, and how far [m] the robot is off it."""
    apart = np.hypot(route.poses[:, 0] - pose[0], route.poses[:, 1] - pose[1])
    nearest = int(np.argmin(apart))
    return nearest, float(apart[nearest])


def cost_left(costs: CostMap, route: Route, since: int = 0) -> float:
    """What the route costs from its pose number `since` on, in cells of the least price."""
    first = max(since, route.leaving)
    return path_cost(costs.prices, route.cells_at(costs.frame)[first:], BLOCKED)


def obstructed(costs: CostMap, route: Route, since: int) -> int | None:
    """Number of the route's first pose, from number `since` on, with the way behind it blocked.

    The map may be another than the route was planned on; what lies off it is blocked.
    """
    first = max(since, route.leaving)
    at = first_closed_segment(costs.prices, route.cells_at(costs.frame)[first:], BLOCKED)
    return None if at < 0 else first + at


def _closed(prices: CellCosts, cell: Cell) -> bool:
    return bool(prices[cell[0] + MARGIN, cell[1] + MARGIN] >= CLOSED)


def _why_closed(costs: CostMap, cell: Cell) -> str:
    if costs.unknown(cell):
        return "is in unknown space"
    if not _closed(costs.map_prices, cell):
        return "is too near to what the scanner sees"
    if costs.obstacle(cell):
        return "is in an obstacle"
    fits = costs.prices[cell[0] + MARGIN, cell[1] + MARGIN] < BLOCKED
    near = costs.costs.radius + (costs.costs.margin if fits else 0.0)
    return f"is nearer than {near:g} m to an obstacle"


def _places(costs: CostMap, points: Array) -> tuple[Array, Array]:
    """x and y [m] of points in cells."""
    ox, oy, theta = costs.frame.origin
    x, y = points[:, 0] * costs.frame.resolution, points[:, 1] * costs.frame.resolution
    cosine, sine = math.cos(theta), math.sin(theta)
    return ox + cosine * x - sine * y, oy + sine * x + cosine * y


def _cells(frame: Frame, poses: Array) -> Array:
    """Points (n, 2) in cells of the places of poses."""
    ox, oy, theta = frame.origin
    dx, dy = poses[:, 0] - ox, poses[:, 1] - oy
    cosine, sine = math.cos(theta), math.sin(theta)
    return np.column_stack((cosine * dx + sine * dy, cosine * dy - sine * dx)) / frame.resolution


def _place(pose: tuple[float, ...]) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f})"
