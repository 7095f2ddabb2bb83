"""The path planner and zones of the map: keepout, slow, lanes, and robots in keepout zones."""

import numpy as np
import pytest

from cairn.components.path_planner.component import PathPlanner
from cairn.components.path_planner.cost_map import CostMap, CostParameters
from cairn.planar.messages import planar_poses
from cairn.planar.polygons import distance_to_edges, is_inside
from cairn.planar.poses import Pose
from cairn.planar.shortest_path import MIN_COST
from cairn.planar.zones import zone_edges, zone_of
from cairn.schemas.cairn_nav_msgs import Plan, Zone, Zones
from cairn.schemas.nav_msgs import OccupancyGrid
from cairn.testing.lockstep import ComponentHarness
from tests import zone_features
from tests.components.path_planner.planner_harness import (
    HERE,
    THERE,
    map_update,
    start_planner,
)
from tests.components.path_planner.rooms import Box, as_map, follow, pose_at, room

RADIUS, MARGIN = 0.22, 0.05
MIDDLE: Box = (3.5, 2.0, 5.5, 5.0)


def area(kind: str, box: Box, name: str = "area", **properties: float) -> Zone:
    return zone_of(zone_features.area(kind, box, name, **properties))


def lane(*points: tuple[float, float]) -> Zone:
    return zone_of(zone_features.lane(*points, width=0.6))


def planned(
    *zones: Zone,
    pose: Pose = HERE,
    goal: Pose = THERE,
    boxes: tuple[Box, ...] = (),
    **parameters: object,
) -> Plan:
    """Return the plan to a goal on a map with zones."""
    planner = start_planner(room(boxes), pose, **parameters)
    planner.publish("zones", Zones(version=1, zones=zones))
    planner.publish("nav_command", follow(goal))
    planner.run_for(0.3)
    return last_plan(planner)


def last_plan(planner: ComponentHarness[PathPlanner]) -> Plan:
    plan = planner.take("plan")[-1]
    assert isinstance(plan, Plan)
    return plan


def distance_to(plan: Plan, zone: Zone, first: int = 0) -> float:
    """Return the least distance [m] of a plan to a zone, 0 if it leads through."""
    edges = zone_edges(zone)
    points = planar_poses(plan.poses)[first:, :2].tolist()
    if any(is_inside(edges, x, y) for x, y in points):
        return 0.0
    return min(distance_to_edges(edges, x, y) for x, y in points)


def test_path_keeps_the_robot_and_its_margin_out_of_a_keepout_zone() -> None:
    zone = area("keepout", MIDDLE)
    assert distance_to(planned(), zone) == 0.0
    plan = planned(zone)
    assert plan.outcome == Plan.FOUND
    assert distance_to(plan, zone) >= RADIUS + MARGIN - 0.01


def test_new_keepout_zone_on_the_path_is_planned_around_at_once() -> None:
    planner = start_planner(room())
    planner.publish("nav_command", follow(THERE))
    zone = area("keepout", MIDDLE)
    assert distance_to(last_plan(planner), zone) == 0.0

    planner.publish("zones", Zones(version=1, zones=(zone,)))

    assert distance_to(last_plan(planner), zone) >= RADIUS + MARGIN - 0.01


def test_removed_keepout_zone_is_driven_through_again() -> None:
    zone = area("keepout", MIDDLE)
    planner = start_planner(room())
    planner.publish("zones", Zones(version=1, zones=(zone,)))
    planner.publish("nav_command", follow(THERE))
    planner.publish("zones", Zones(version=2))
    assert distance_to(last_plan(planner), zone) == 0.0


def test_map_that_arrives_after_the_zones_has_them() -> None:
    zone = area("keepout", MIDDLE)
    planner = start_planner(None)
    planner.publish("zones", Zones(version=1, zones=(zone,)))
    planner.publish("map", as_map(room()))
    planner.publish("map_updates", map_update((2.0, 3.0, 2.2, 3.2), 100))
    planner.publish("nav_command", follow(THERE))
    assert distance_to(last_plan(planner), zone) >= RADIUS + MARGIN - 0.01


def test_update_of_the_map_in_a_keepout_zone_leaves_it_closed() -> None:
    zone = area("keepout", MIDDLE)
    costs = CostMap(room(), PARAMETERS, [zone])
    before = costs.cell_costs.copy()
    costs.update(50, 80, np.full((4, 4), 100, np.int8))
    costs.update(50, 80, np.zeros((4, 4), np.int8))
    np.testing.assert_array_equal(costs.cell_costs, before)


def test_goal_in_a_keepout_zone_is_refused_with_the_nearest_allowed_position() -> None:
    zone = area("keepout", MIDDLE, "wet floor")
    plan = planned(zone, goal=(3.8, 3.0, 0.0))
    assert plan.outcome == Plan.GOAL_IN_KEEPOUT
    assert "(3.80, 3.00) is in keepout zone wet floor" in plan.reason
    assert (plan.nearest_x, plan.nearest_y) == pytest.approx((3.175, 3.0), abs=0.06)


def test_goal_beside_a_keepout_zone_where_the_robot_does_not_fit_is_refused() -> None:
    plan = planned(area("keepout", MIDDLE, "wet floor"), goal=(3.4, 3.0, 0.0))
    assert plan.outcome == Plan.GOAL_IN_KEEPOUT
    assert "is 0.10 m from keepout zone wet floor" in plan.reason


def test_goal_behind_keepout_zones_is_reported_as_closed_by_them() -> None:
    plan = planned(area("keepout", (4.0, -1.0, 4.5, 8.0)))
    assert plan.outcome == Plan.UNREACHABLE
    assert "keepout zones close every path" in plan.reason
    assert plan.nearest_x < 4.0


def test_robot_in_a_keepout_zone_leaves_it_by_the_shortest_way() -> None:
    zone = area("keepout", (0.2, 2.0, 5.0, 5.0))
    pose = (2.0, 2.5, 0.0)  # 0.5 m from the lower edge; the goal is beyond the upper one
    plan = planned(zone, pose=pose, goal=(2.0, 6.0, 0.0))
    assert plan.outcome == Plan.FOUND
    poses = planar_poses(plan.poses)
    inside = [is_inside(zone_edges(zone), x, y) for x, y in poses[:, :2].tolist()]
    leaves = inside.index(False)
    assert not any(inside[leaves:])
    way = np.hypot(*np.diff(poses[: leaves + 1, :2], axis=0).T).sum()
    assert way < 0.65
    assert poses[leaves, 1] < 2.0


def test_shortest_way_out_leads_around_obstacles() -> None:
    zone = area("keepout", (0.2, 2.0, 5.0, 5.0))
    wall: Box = (0.1, 1.9, 4.0, 2.0)
    plan = planned(zone, pose=(2.0, 2.5, 0.0), goal=(2.0, 6.0, 0.0), boxes=(wall,))
    assert plan.outcome == Plan.FOUND
    poses = planar_poses(plan.poses)
    assert poses[:, 1].min() > 2.2


def test_robot_in_a_keepout_zone_without_a_way_out_is_blocked() -> None:
    zone = area("keepout", (-1.0, -1.0, 10.0, 8.0), "all")
    plan = planned(zone)
    assert plan.outcome == Plan.START_BLOCKED
    assert "in keepout zone all, and no way leads out of it" in plan.reason


def test_robot_in_a_keepout_zone_stops_there_if_configured() -> None:
    zone = area("keepout", (0.2, 0.2, 3.0, 3.0), "wet floor")
    plan = planned(zone, in_keepout="stop")
    assert plan.outcome == Plan.START_IN_KEEPOUT
    assert "(1.00, 1.00) is in keepout zone wet floor" in plan.reason
    assert "drive it out" in plan.reason


def test_robot_that_was_driven_out_of_a_keepout_zone_plans_again() -> None:
    zone = area("keepout", (0.2, 0.2, 3.0, 3.0))
    planner = start_planner(room(), in_keepout="stop")
    planner.publish("zones", Zones(version=1, zones=(zone,)))
    planner.publish("nav_command", follow(THERE))
    planner.publish("localization", pose_at((4.0, 1.0, 0.0), planner.now))
    planner.run_for(2.0)
    assert last_plan(planner).outcome == Plan.FOUND


def test_path_takes_the_way_around_a_slow_zone_that_costs_less_time() -> None:
    slow = area("slow", (4.0, 0.0, 5.0, 5.0), speed=0.1)
    there = (8.0, 1.0, 0.0)
    # Through it 1 m at 0.1 m/s takes 10 s, around it 4 m more at 0.6 m/s less than 7 s.
    assert planar_poses(planned(slow, goal=there).poses)[:, 1].max() > 4.9
    brief = area("slow", (4.0, 0.0, 5.0, 5.0), speed=0.4)
    assert planar_poses(planned(brief, goal=there).poses)[:, 1].max() < 1.1


def test_slow_zone_faster_than_the_robot_costs_nothing() -> None:
    fast = area("slow", MIDDLE, speed=0.6)
    costs = CostMap(room(), PARAMETERS, [fast])
    np.testing.assert_array_equal(costs.cell_costs, CostMap(room(), PARAMETERS).cell_costs)


def test_path_prefers_a_lane() -> None:
    there = (8.0, 1.0, 0.0)
    straight = planar_poses(planned(goal=there).poses)
    assert np.abs(straight[:, 1] - 1.0).max() < 0.1
    on_lane = planar_poses(planned(lane((1.5, 2.0), (7.5, 2.0)), goal=there).poses)
    middle = on_lane[(on_lane[:, 0] > 3.0) & (on_lane[:, 0] < 6.0), 1]
    assert middle.min() > 1.7 - 0.05


def test_lane_that_is_too_far_away_is_not_used() -> None:
    there = (8.0, 1.0, 0.0)
    path = planar_poses(planned(lane((1.5, 6.0), (7.5, 6.0)), goal=there).poses)
    assert np.abs(path[:, 1] - 1.0).max() < 0.1


def test_changed_zones_give_the_same_costs_as_a_new_map() -> None:
    sets = [
        [area("keepout", MIDDLE, "a"), area("slow", (1.0, 1.0, 4.0, 4.0), "b", speed=0.2)],
        [area("slow", (1.0, 1.0, 4.0, 4.0), "b", speed=0.3), area("keepout", (6, 1, 7, 2), "c")],
        [lane((1.0, 3.0), (8.0, 4.0)), area("slow", (1.0, 1.0, 4.0, 4.0), "b", speed=0.3)],
        [lane((1.0, 3.0), (8.0, 5.0)), area("keepout", (-9.0, 3.0, 1.0, 4.0), "d")],
        [],
        [area("slow", (1.0, 1.0, 2.0, 2.0), "a", speed=0.1), area("keepout", MIDDLE, "c")],
        [area("slow", (1.5, 1.5, 2.5, 2.5), "b", speed=0.3), area("keepout", MIDDLE, "c")],
        [area("slow", (1.5, 1.5, 2.5, 2.5), "b", speed=0.3)],
    ]
    grid = room([(2.0, 2.0, 3.0, 3.0)], origin=(-0.3, 0.2, 0.1))
    costs = CostMap(grid, PARAMETERS)
    for zones in sets:
        costs.set_zones(zones)
        fresh = CostMap(grid, PARAMETERS, zones)
        np.testing.assert_array_equal(costs.cell_costs, fresh.cell_costs)
        np.testing.assert_array_equal(costs.costs_without_keepout(), fresh.costs_without_keepout())


def test_no_cell_is_cheaper_than_a_free_one() -> None:
    zones = [lane((1.0, 1.0), (8.0, 1.0)), area("slow", MIDDLE, speed=0.1)]
    costs = CostMap(room(), PARAMETERS, zones)
    assert costs.cell_costs.min() == MIN_COST


PARAMETERS = CostParameters(
    radius=RADIUS,
    inflation_distance=0.45,
    inflation_weight=1.0,
    margin=MARGIN,
    allow_unknown=False,
)


def test_empty_map_is_ignored_with_zones() -> None:
    planner = start_planner(None)
    planner.publish("zones", Zones(version=1, zones=(area("keepout", MIDDLE),)))
    planner.publish("map", OccupancyGrid())
    planner.publish("nav_command", follow(THERE))
    assert last_plan(planner).outcome == Plan.NOT_READY
