"""Plan a path between two poses over a cost map, or find the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cairn.components.path_planner.cost_map import BLOCKED, CostMap, nearest_open
from cairn.components.path_planner.zone_cells import way_out
from cairn.planar.grid import Frame
from cairn.planar.path_shape import (
    cell_centers,
    first_closed_segment,
    path_cost,
    pull_taut,
    resampled,
)
from cairn.planar.poses import Pose
from cairn.planar.shortest_path import (
    CLOSED,
    MARGIN,
    MIN_COST,
    Cell,
    CellCosts,
    PathSearch,
)

Array = NDArray[np.float64]

# A robot that seems to be inside an obstacle by no more than this [m] can leave it: localization
# and scans are noisy. Chosen by hand; `lab/constants.yaml` has the effect of half and
# double.
ESCAPE_M = 0.4
# Cells around the robot among which the way out of a keepout zone is sought at first, 3 m of the
# usual 0.05 m; and by how much a way of steps is longer than a straight line (2.8 %), rounded up.
_FIRST_REACH, _ABOUT_STRAIGHT = 64, 1.03
# Larger coordinates [m] are rejected: their squares in cells would overflow.
_MAX_COORDINATE_M = 1e9


class PlanOutcome(IntEnum):
    """The outcome of planning, with the numbers of the message Plan."""

    FOUND = 0
    NOT_READY = 1
    START_BLOCKED = 2
    GOAL_BLOCKED = 3
    OUTSIDE_MAP = 4
    UNREACHABLE = 5
    GOAL_IMPOSSIBLE = 6
    GOAL_IN_KEEPOUT = 7
    START_IN_KEEPOUT = 8


@dataclass(frozen=True)
class PlannedPath:
    """Poses (n, 3) in frame map, and the same points (n, 2) in cells of a map at `frame`.

    The first `leaving` segments lead a robot out of an obstacle that it seems to be in, or out of a
    keepout zone.
    """

    poses: Array
    points: Array
    frame: Frame
    leaving: int

    def length(self, since: int = 0) -> float:
        """Return its length [m] from the pose with index `since` on."""
        steps = np.diff(self.poses[since:, :2], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def index_beyond(self, since: int, length: float) -> int:
        """Return the index of the pose `length` [m] beyond the one at `since`, at most the last."""
        steps = np.diff(self.poses[since:, :2], axis=0)
        along = np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))
        return min(since + 1 + int(np.searchsorted(along, length)), len(self.poses) - 1)

    def cells_at(self, frame: Frame) -> Array:
        """Return the points (n, 2) in cells of a map at `frame`.

        They are computed from the poses only if the frame differs: a rounded point on the edge of a
        cell may fall into the closed cell beside it.
        """
        if frame == self.frame:
            return self.points
        return _cells(frame, self.poses)


@dataclass(frozen=True)
class PlanResult:
    """A path, or the reason for its absence and the reachable position x, y [m] nearest to the
    goal.
    """

    outcome: PlanOutcome
    route: PlannedPath | None = None
    reason: str = ""
    nearest: tuple[float, float] | None = None


class Planner:
    """Plans over the current cost map, in memory that is allocated once per map size."""

    def __init__(self, step_m: float) -> None:
        self._step_m = step_m
        self._search = PathSearch((0, 0))

    def prepare(self, costs: CostMap) -> None:
        """Allocate the memory for plans over a map of this size."""
        if self._search.shape != costs.cell_costs.shape:
            self._search = PathSearch(costs.cell_costs.shape)

    def plan(
        self, costs: CostMap, start: Pose, goal: Pose, *, may_leave_keepout: bool = True
    ) -> PlanResult:
        """Return a path from the robot's pose to the goal's, with poses about `step_m` apart.

        From a robot in a keepout zone it leads out by the shortest way, if `may_leave_keepout`.
        """
        if not all(abs(value) < _MAX_COORDINATE_M for value in goal):
            return PlanResult(
                PlanOutcome.OUTSIDE_MAP, reason=f"the goal {goal} is not a valid position"
            )
        self.prepare(costs)
        begin = costs.cell(start[0], start[1])
        if begin is None:
            return PlanResult(
                PlanOutcome.START_BLOCKED,
                reason=f"the robot at {_format(start)} is outside the map",
            )
        way: _WayOut | None = None
        if costs.is_in_keepout(begin):
            leaving = self._way_out(costs, start, begin, may_leave_keepout=may_leave_keepout)
            if isinstance(leaving, PlanResult):
                return leaving
            way, start_cell = leaving, leaving.end
        else:
            found = self._start_cell(costs, costs.cell_costs, start, begin)
            if isinstance(found, PlanResult):
                return found
            start_cell = found
        target = costs.cell(goal[0], goal[1])
        if target is None:
            return self._nearest_reachable(
                costs,
                start_cell,
                goal,
                PlanOutcome.OUTSIDE_MAP,
                f"{_format(goal)} is outside the map",
            )
        goal_cell = self._goal_cell(costs, goal, target)
        if goal_cell is None:
            if costs.is_closed_by_keepout(target):
                problem = f"{_format(goal)} {_keepout_reason(costs, goal)}"
                return self._nearest_reachable(
                    costs, start_cell, goal, PlanOutcome.GOAL_IN_KEEPOUT, problem
                )
            obstacle = _permanent_obstacle(costs, target)
            blocked = PlanOutcome.GOAL_IMPOSSIBLE if obstacle else PlanOutcome.GOAL_BLOCKED
            return self._nearest_reachable(
                costs, start_cell, goal, blocked,
                f"{_format(goal)} {obstacle or _closed_reason(costs, target)}",
            )  # fmt: skip
        search = self._search.find(costs.cell_costs, start_cell, goal_cell)
        if search.cells is None:
            return self._unreachable(costs, start_cell, start, goal, search.nearest)
        return PlanResult(
            PlanOutcome.FOUND,
            self._build_path(costs, costs.cell_costs, search.cells, start, goal, way),
        )

    def _way_out(
        self, costs: CostMap, start: Pose, begin: Cell, *, may_leave_keepout: bool
    ) -> _WayOut | PlanResult:
        """Return the shortest way out of the keepout zones around the robot."""
        where = f"the robot at {_format(start)} {_keepout_reason(costs, start)}"
        if not may_leave_keepout:
            return PlanResult(
                PlanOutcome.START_IN_KEEPOUT,
                reason=f"{where}; drive it out, or change the zone (in_keepout is stop)",
            )
        passable = costs.costs_without_keepout()
        found = self._start_cell(costs, passable, start, begin)
        if isinstance(found, PlanResult):
            return found
        cells = self._shortest_way_out(costs, passable, found)
        if cells is None:
            reason = f"{where}, and no way leads out of it"
            return PlanResult(PlanOutcome.START_BLOCKED, reason=reason)
        closed = found != begin
        line = cell_centers(cells)
        if not closed:
            line[0] = costs.frame.cells(start[0], start[1])
        points = resampled(
            passable, pull_taut(passable, line), self._step_m / costs.frame.resolution
        )
        if closed:
            points = np.vstack(([costs.frame.cells(start[0], start[1])], points))
        end = int(cells[-1, 0]), int(cells[-1, 1])
        return _WayOut(points, end)

    def _shortest_way_out(
        self, costs: CostMap, passable: CellCosts, start: Cell
    ) -> NDArray[np.int64] | None:
        """Return the cells of the way; at first to the nearest open cell, which few searches take.

        If obstacles make that way longer than the straight line, another one may be shorter.
        """
        nearest = nearest_open(costs.cell_costs, start[0] + 0.5, start[1] + 0.5)
        if nearest is None:
            return None
        lengths = np.where(passable < CLOSED, MIN_COST, CLOSED).astype(np.uint8)
        cells = self._search.find(lengths, start, nearest[0]).cells
        if cells is None:
            return way_out(passable, costs.cell_costs, start, _FIRST_REACH)
        steps = np.diff(cells, axis=0)
        length = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        if length > _ABOUT_STRAIGHT * nearest[1] + 1.0:
            return way_out(passable, costs.cell_costs, start, math.ceil(length))
        is_open = costs.cell_costs[cells[:, 0] + MARGIN, cells[:, 1] + MARGIN] < CLOSED
        first: int = int(np.argmax(is_open))
        return cells[: first + 1]

    def _start_cell(
        self, costs: CostMap, cell_costs: CellCosts, start: Pose, begin: Cell
    ) -> Cell | PlanResult:
        """Return the cell to start in: the robot's, or the nearest open one."""
        if not _closed(cell_costs, begin):
            return begin
        column, row = costs.frame.cells(start[0], start[1])
        found = nearest_open(cell_costs, row, column)
        if found is not None and found[1] * costs.frame.resolution <= ESCAPE_M:
            return found[0]
        reason = f"the robot at {_format(start)} {_closed_reason(costs, begin)}"
        if found is not None:
            position = costs.frame.point(*found[0])
            distance = found[1] * costs.frame.resolution
            reason += f"; the nearest free position, {_format(position)}, is {distance:.2f} m away"
        return PlanResult(PlanOutcome.START_BLOCKED, reason=reason)

    def _goal_cell(self, costs: CostMap, goal: Pose, target: Cell) -> Cell | None:
        """Return the cell to end in: the goal's, or the nearest from which the robot fits to the
        goal.
        """
        if not _closed(costs.cell_costs, target):
            return target
        column, row = costs.frame.cells(goal[0], goal[1])
        found = nearest_open(costs.cell_costs, row, column)
        if found is None or found[1] * costs.frame.resolution > ESCAPE_M:
            return None
        last = np.array([(found[0][1] + 0.5, found[0][0] + 0.5), (column, row)])
        return found[0] if first_closed_segment(costs.cell_costs, last, BLOCKED) < 0 else None

    def _nearest_reachable(
        self, costs: CostMap, begin: Cell, goal: Pose, outcome: PlanOutcome, problem: str
    ) -> PlanResult:
        """Return the result for an impossible goal, with the nearest reachable position."""
        column, row = costs.frame.cells(goal[0], goal[1])
        free = nearest_open(costs.cell_costs, row, column)
        assert free is not None  # the start cell is open
        search = self._search.find(costs.cell_costs, begin, free[0])
        reached = free[0] if search.cells is not None else search.nearest
        nearest = costs.frame.point(*reached)
        apart = math.hypot(nearest[0] - goal[0], nearest[1] - goal[1])
        return PlanResult(
            outcome,
            reason=f"the goal {problem}; the nearest reachable position, {_format(nearest)}, "
            f"is {apart:.2f} m from it",
            nearest=nearest,
        )

    def _unreachable(
        self, costs: CostMap, begin: Cell, start: Pose, goal: Pose, reached: Cell
    ) -> PlanResult:
        nearest = costs.frame.point(*reached)
        apart = math.hypot(nearest[0] - goal[0], nearest[1] - goal[1])
        return PlanResult(
            PlanOutcome.UNREACHABLE,
            reason=f"{self._unreachable_reason(costs, begin, start, goal)} from "
            f"{_format(start)} to "
            f"{_format(goal)}; the nearest reachable position, {_format(nearest)}, is "
            f"{apart:.2f} m from the goal",
            nearest=nearest,
        )

    def _unreachable_reason(self, costs: CostMap, begin: Cell, start: Pose, goal: Pose) -> str:
        """Return whether the map has no path, or which obstacle of the scanner closes it."""
        target = self._goal_cell(costs, goal, costs.frame.cell(goal[0], goal[1]))
        assert target is not None  # otherwise the goal would have been rejected
        search = (
            self._search.find(costs.map_costs, begin, target)
            if costs.has_scanner_obstacles
            else None
        )
        if search is None or search.cells is None:
            if costs.has_keepout_zones:
                search = self._search.find(costs.costs_without_keepout(), begin, target)
                if search.cells is not None:
                    return "keepout zones close every path"
            return "there is no path"
        route = self._build_path(costs, costs.map_costs, search.cells, start, goal)
        at = first_closed_segment(costs.cell_costs, route.points[route.leaving :]) + route.leaving
        x, y = costs.nearest_scanner_obstacle(*route.poses[at, :2])
        return f"blocked by an obstacle that the scanner sees at {_format((x, y))}"

    def _build_path(
        self,
        costs: CostMap,
        cell_costs: CellCosts,
        cells: NDArray[np.int64],
        start: Pose,
        goal: Pose,
        way: _WayOut | None = None,
    ) -> PlannedPath:
        frame = costs.frame
        start_point, goal_point = frame.cells(start[0], start[1]), frame.cells(goal[0], goal[1])
        leaving = way is not None or _closed(cell_costs, frame.cell(start[0], start[1]))
        entering = _closed(cell_costs, frame.cell(goal[0], goal[1]))
        head = np.empty((0, 2)) if leaving else np.array([start_point])
        tail = np.empty((0, 2)) if entering else np.array([goal_point])
        line = pull_taut(cell_costs, np.vstack((head, cell_centers(cells), tail)))
        points = resampled(cell_costs, line, self._step_m / frame.resolution)
        left = int(leaving)
        if way is not None:
            left = len(way.points) - 1
            points = np.vstack((way.points[:-1], points))
        elif leaving:
            points = np.vstack(([start_point], points))
        if entering:
            points = np.vstack((points, [goal_point]))
        poses = np.empty((len(points), 3))
        poses[:, 0], poses[:, 1] = _positions(costs, points)
        ahead = np.diff(poses[:, :2], axis=0)
        mean = ahead.copy()
        mean[1:] += ahead[:-1]
        poses[:-1, 2] = np.arctan2(mean[:, 1], mean[:, 0])
        poses[0, :2] = start[:2]
        poses[-1] = goal
        return PlannedPath(poses, points, frame, left)


@dataclass(frozen=True)
class _WayOut:
    """The way out of a keepout zone: points (n, 2) in cells, and the open cell that it ends in."""

    points: Array
    end: Cell


def nearest_pose(route: PlannedPath, pose: Pose) -> tuple[int, float]:
    """Return the index of the path's pose nearest to the robot, and its distance [m]."""
    apart = np.hypot(route.poses[:, 0] - pose[0], route.poses[:, 1] - pose[1])
    nearest = int(np.argmin(apart))
    return nearest, float(apart[nearest])


def remaining_cost(costs: CostMap, route: PlannedPath, since: int = 0) -> float:
    """Return the cost of the path from the pose with index `since` on, in free cells."""
    first = max(since, route.leaving)
    return path_cost(costs.cell_costs, route.cells_at(costs.frame)[first:], BLOCKED)


def first_blocked(costs: CostMap, route: PlannedPath, since: int) -> int | None:
    """Return the index of the first pose, from `since` on, after which the path is blocked.

    The map may differ from the one of the plan; everything outside the map is blocked.
    """
    first = max(since, route.leaving)
    at = first_closed_segment(costs.cell_costs, route.cells_at(costs.frame)[first:], BLOCKED)
    return None if at < 0 else first + at


def _closed(cell_costs: CellCosts, cell: Cell) -> bool:
    return bool(cell_costs[cell[0] + MARGIN, cell[1] + MARGIN] >= CLOSED)


def _closed_reason(costs: CostMap, cell: Cell) -> str:
    if costs.is_unknown_space(cell):
        return "is in unknown space"
    if not _closed(costs.map_costs, cell):
        return "is too near to an obstacle that the scanner sees"
    if costs.is_closed_by_keepout(cell):
        return _keepout_reason(costs, costs.frame.point(*cell))
    if costs.is_obstacle(cell):
        return "is in an obstacle"
    fits = costs.cell_costs[cell[0] + MARGIN, cell[1] + MARGIN] < BLOCKED
    near = costs.costs.radius + (costs.costs.margin if fits else 0.0)
    return f"is nearer than {near:g} m to an obstacle"


def _keepout_reason(costs: CostMap, position: tuple[float, ...]) -> str:
    name, apart = costs.nearest_keepout(position[0], position[1])
    if apart == 0.0:
        return f"is in keepout zone {name}"
    return f"is {apart:.2f} m from keepout zone {name}, too near to it"


def _permanent_obstacle(costs: CostMap, cell: Cell) -> str:
    """Return why the map excludes a goal in this cell permanently; empty if it may become free.

    Furniture may have been moved since it was mapped, and its inside is unknown: from near, the
    robot sees that it is gone.
    """
    if not costs.is_at_wall(cell):
        return ""
    if costs.is_unknown_space(cell):
        return "is in unknown space"
    return "is in a wall" if costs.is_obstacle(cell) else "is too near to a wall"


def _positions(costs: CostMap, points: Array) -> tuple[Array, Array]:
    """Return x and y [m] of points in cells."""
    ox, oy, theta = costs.frame.origin
    x, y = points[:, 0] * costs.frame.resolution, points[:, 1] * costs.frame.resolution
    cosine, sine = math.cos(theta), math.sin(theta)
    return ox + cosine * x - sine * y, oy + sine * x + cosine * y


def _cells(frame: Frame, poses: Array) -> Array:
    """Return the positions of poses in cells (n, 2)."""
    ox, oy, theta = frame.origin
    dx, dy = poses[:, 0] - ox, poses[:, 1] - oy
    cosine, sine = math.cos(theta), math.sin(theta)
    return np.column_stack((cosine * dx + sine * dy, cosine * dy - sine * dx)) / frame.resolution


def _format(pose: tuple[float, ...]) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f})"
