"""Plans in rooms are short, clear of walls and drivable; failures have reason and alternative."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.components.motion_control.config import MotionControlConfig
from cairn.components.path_planner.config import PathPlannerConfig
from cairn.components.path_planner.cost_map import CostMap, CostParameters
from cairn.components.path_planner.planning import PlannedPath, Planner, PlanOutcome, PlanResult
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose
from tests.components.path_planner.rooms import clearance, room, wall_with_door
from tests.sweeps import sampled
from tests.wording import assert_words

COSTS = CostParameters(
    radius=0.22,
    inflation_distance=0.45,
    inflation_weight=1.0,
    margin=0.05,
    allow_unknown=False,
)
SHORTEST = replace(COSTS, inflation_weight=0.0)
START, GOAL = (1.0, 1.0, 0.0), (8.0, 6.0, 1.0)


def plan(
    grid: OccupancyCells, start: Pose = START, goal: Pose = GOAL, costs: CostParameters = COSTS
) -> PlanResult:
    return Planner(0.1).plan(CostMap(grid, costs), start, goal)


def route(
    grid: OccupancyCells, start: Pose = START, goal: Pose = GOAL, costs: CostParameters = COSTS
) -> PlannedPath:
    answer = plan(grid, start, goal, costs)
    assert answer.route is not None, answer.reason
    return answer.route


def between(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 2) all along a path, not only at its poses."""
    shares = np.linspace(0, 1, 6)[:, None, None]
    places: NDArray[np.float64] = poses[:-1, :2] + shares * np.diff(poses[:, :2], axis=0)
    return places.reshape(-1, 2)


def turns(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    headings = np.arctan2(*np.diff(poses[:, :2], axis=0).T[::-1])
    turned: NDArray[np.float64] = (np.diff(headings) + math.pi) % (2 * math.pi) - math.pi
    return np.abs(turned)


def furnished(seed: int) -> OccupancyCells:
    rng = np.random.default_rng(seed)
    corners = rng.uniform([1.6, 0.3], [6.0, 5.0], (7, 2))
    sizes = rng.uniform(0.2, 1.4, (7, 2))
    return room([(x, y, x + w, y + h) for (x, y), (w, h) in zip(corners, sizes, strict=True)])


def test_path_leads_from_the_robot_to_the_goal_and_its_heading() -> None:
    found = route(room())

    assert tuple(found.poses[0, :2]) == START[:2]
    assert tuple(found.poses[-1]) == GOAL
    assert found.length() == pytest.approx(math.hypot(7, 5), rel=0.01)
    steps = np.hypot(*np.diff(found.poses[:, :2], axis=0).T)
    assert steps.max() <= 0.1 + 1e-9
    np.testing.assert_allclose(found.poses[:-1, 2], math.atan2(5, 7), atol=0.05)


def test_rotated_map_is_planned_on_in_its_frame() -> None:
    origin = (-20.0, 5.0, 2.0)
    there = [
        (
            origin[0] + math.cos(2.0) * x - math.sin(2.0) * y,
            origin[1] + math.sin(2.0) * x + math.cos(2.0) * y,
            0.0,
        )
        for x, y in ((1.0, 1.0), (8.0, 6.0))
    ]
    boxes = wall_with_door(0.9)

    askew = route(room(boxes, origin=origin), there[0], there[1])

    assert askew.length() == pytest.approx(route(room(boxes)).length(), abs=0.01)
    assert tuple(askew.poses[-1]) == there[1]


@pytest.mark.parametrize("seed", sampled(range(20), 4))
def test_paths_keep_clear_turn_gently_and_are_nearly_the_shortest(seed: int) -> None:
    grid = furnished(seed)
    found, shortest = route(grid), route(grid, costs=SHORTEST)

    # A closed cell begins where its center is 0.295 m from an obstacle's: 0.25 m from its edge.
    for poses in (found.poses, shortest.poses):
        assert clearance(grid, between(poses)).min() >= 0.25 - 1e-9
    assert shortest.length() - 1e-6 <= found.length() <= 1.2 * shortest.length()
    near, nearer = (
        (clearance(grid, places.poses[:, :2]) < 0.35).mean() for places in (found, shortest)
    )
    assert near <= nearer + 0.02
    assert turns(found.poses).max() < 0.5
    assert turns(found.poses).sum() < 5.0


def test_path_keeps_away_from_a_corner_where_there_is_room() -> None:
    grid = room([(4.0, 0.0, 5.0, 3.5)])

    assert clearance(grid, route(grid).poses[:, :2]).min() > 0.35
    assert clearance(grid, route(grid, costs=SHORTEST).poses[:, :2]).min() < 0.31


def test_path_passes_a_90_cm_door_in_its_middle() -> None:
    found = route(room(wall_with_door(0.9, low=2.0)))

    crossing = found.poses[np.argmin(np.abs(found.poses[:, 0] - 4.55))]
    assert crossing[1] == pytest.approx(2.45, abs=0.1)


@pytest.mark.parametrize(
    ("width", "passed"), [(0.4, False), (0.5, False), (0.6, True), (0.7, True)]
)
def test_door_is_passed_if_the_robot_and_its_margin_fit(width: float, passed: bool) -> None:
    answer = plan(room(wall_with_door(width)))

    assert (answer.outcome is PlanOutcome.FOUND) == passed


def test_goal_behind_walls_is_unreachable_and_the_nearest_position_is_reported() -> None:
    answer = plan(room([(4.5, 0.0, 4.6, 7.0)]), goal=(6.0, 3.0, 0.0))

    assert answer.outcome is PlanOutcome.UNREACHABLE
    assert_words(answer.reason, "no path", "(1.00, 1.00)", "(6.00, 3.00)")
    assert answer.nearest == pytest.approx((4.225, 3.0), abs=0.06)
    assert answer.route is None


def test_goal_in_an_obstacle_is_rejected_with_the_nearest_free_position() -> None:
    answer = plan(room([(5.0, 2.0, 7.0, 4.0)]), goal=(5.5, 3.0, 0.0))

    assert answer.outcome is PlanOutcome.GOAL_BLOCKED
    assert_words(answer.reason, "goal (5.50, 3.00)", "obstacle")
    assert "is 0.78 m from it" in answer.reason
    assert answer.nearest == pytest.approx((4.775, 3.0), abs=0.06)


def test_goal_in_the_margin_of_a_wall_can_be_reached_and_left() -> None:
    beside = (0.35, 3.0, 0.0)  # 0.25 m from the wall
    grid = room()

    for found in (route(grid, goal=beside), route(grid, start=beside)):
        assert clearance(grid, found.poses[:, :2]).min() == pytest.approx(0.25)
        assert np.sort(clearance(grid, found.poses[:, :2]))[1] > 0.25 + 0.01


def test_goal_too_near_to_an_obstacle_is_rejected_as_such() -> None:
    answer = plan(room([(5.0, 2.5, 5.8, 3.5)]), goal=(5.95, 3.0, 0.0))

    assert answer.outcome is PlanOutcome.GOAL_BLOCKED
    assert_words(answer.reason, "0.22 m", "obstacle")


@pytest.mark.parametrize(
    ("x", "reason"), [(8.98, "is in a wall"), (8.8, "is too near to a wall")], ids=["in", "beside"]
)
def test_goal_at_a_wall_is_impossible(x: float, reason: str) -> None:
    answer = plan(room(), goal=(x, 3.0, 0.0))

    assert answer.outcome is PlanOutcome.GOAL_IMPOSSIBLE
    assert_words(answer.reason, "goal", reason, "nearest reachable position")


def test_nearest_position_for_an_impossible_goal_is_reachable() -> None:
    grid = room([(4.5, 0.0, 4.6, 7.0), (5.2, 3.0, 6.0, 4.0)])

    answer = plan(grid, goal=(5.3, 3.5, 0.0))

    assert answer.outcome is PlanOutcome.GOAL_BLOCKED
    assert answer.nearest is not None
    assert answer.nearest[0] < 4.5


def test_goal_outside_the_map_is_rejected() -> None:
    answer = plan(room(), goal=(12.0, 3.0, 0.0))

    assert answer.outcome is PlanOutcome.OUTSIDE_MAP
    assert_words(answer.reason, "goal (12.00, 3.00)", "outside the map")
    assert answer.nearest == pytest.approx((8.625, 3.0), abs=0.06)


@pytest.mark.parametrize("x", [math.nan, math.inf, -1e200])
def test_goal_that_is_not_finite_is_rejected(x: float) -> None:
    answer = plan(room(), goal=(x, 3.0, 0.0))

    assert answer.outcome is PlanOutcome.OUTSIDE_MAP
    assert "is not a valid position" in answer.reason


def test_robot_outside_the_map_is_reported() -> None:
    answer = plan(room(), start=(-2.0, 3.0, 0.0))

    assert answer.outcome is PlanOutcome.START_BLOCKED
    assert_words(answer.reason, "(-2.00, 3.00)", "outside the map")


def test_robot_slightly_inside_an_obstacle_finds_its_way_out() -> None:
    grid = room([(0.8, 0.8, 1.3, 1.2)])

    found = route(grid, start=(1.2, 1.0, 0.0))

    assert tuple(found.poses[0, :2]) == (1.2, 1.0)
    assert clearance(grid, between(found.poses[1:])).min() >= 0.2 - 1e-9


def test_robot_deep_inside_an_obstacle_is_reported() -> None:
    answer = plan(room([(0.2, 0.2, 2.0, 2.0)]))

    assert answer.outcome is PlanOutcome.START_BLOCKED
    assert_words(answer.reason, "robot at (1.00, 1.00)", "obstacle")
    assert "m away" in answer.reason


def test_unknown_space_is_passed_only_if_allowed() -> None:
    grid = room(unknown=[(4.0, 0.0, 5.0, 7.0)])

    closed = plan(grid)
    opened = plan(grid, costs=replace(COSTS, allow_unknown=True))
    into = plan(grid, goal=(4.5, 3.0, 0.0))

    assert closed.outcome is PlanOutcome.UNREACHABLE
    assert opened.outcome is PlanOutcome.FOUND
    assert into.outcome is PlanOutcome.GOAL_IMPOSSIBLE
    assert "is in unknown space" in into.reason


def test_goal_at_the_robots_position_gives_a_path() -> None:
    found = route(room(), goal=(1.0, 1.0, 2.0))

    assert found.length() == 0.0
    assert tuple(found.poses[-1]) == (1.0, 1.0, 2.0)


def test_one_planner_serves_maps_of_different_sizes() -> None:
    planner = Planner(0.1)
    small, large = room(), room(size=(12.0, 10.0))

    outcomes = [
        planner.plan(CostMap(grid, COSTS), START, GOAL).outcome for grid in (small, large, small)
    ]

    assert outcomes == [PlanOutcome.FOUND] * 3


def test_goal_in_an_obstacle_of_the_scanner_is_rejected_as_such() -> None:
    costs = CostMap(room(), COSTS)
    costs.set_scanner_obstacles(np.argwhere(room([(5.0, 3.0, 5.3, 3.3)]).values != room().values))

    answer = Planner(0.1).plan(costs, START, (5.4, 3.1, 0.0))

    assert answer.outcome is PlanOutcome.GOAL_BLOCKED
    assert_words(answer.reason, "goal (5.40, 3.10)", "too near", "scanner")


def test_planner_and_motion_control_have_the_same_radius_and_margin() -> None:
    planner, control = PathPlannerConfig(), MotionControlConfig()

    assert (planner.radius, planner.margin) == (control.radius, control.margin)
