"""Frontiers: borders on the unknown that the robot can reach, and poses from where it sees them."""

import math

import numpy as np
import pytest

from cairn.components.explorer.choice import FrontierChoice
from cairn.components.explorer.frontiers import Clearance, Frontier, FrontierSearch, Reach
from cairn.planar.grid import Frame, Grid, OccupancyCells
from cairn.planar.polygons import Cells
from cairn.planar.poses import Pose, compose
from tests.components.path_planner.rooms import Box, room

NEEDS = Clearance(fits_m=0.295, body_m=0.27, width_m=0.44)
HERE = (2.0, 3.5, 0.0)


def reach(grid: OccupancyCells, here: Pose = HERE, keepout: Cells | None = None) -> Reach:
    found = FrontierSearch().find(grid, here, NEEDS, keepout)
    assert found is not None
    return found


def only(grid: OccupancyCells, here: Pose = HERE) -> Frontier:
    (frontier,) = reach(grid, here).frontiers
    return frontier


def behind_a_wall(*openings: tuple[float, float]) -> OccupancyCells:
    """A room whose right half is unknown, behind a wall at x = 5 m with openings along y [m]."""
    edges = [0.0, *(y for opening in openings for y in opening), 7.0]
    walls: list[Box] = [(5.0, a, 5.1, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return room(boxes=walls, unknown=[(5.1, 0.1, 8.9, 6.9)])


def test_known_room_has_no_frontier() -> None:
    assert reach(room(boxes=[(4.0, 3.0, 5.0, 4.0)])).frontiers == ()


def test_unknown_half_of_a_room_is_one_frontier_in_front_of_the_robot() -> None:
    frontier = only(room(unknown=[(5.0, 0.1, 8.9, 6.9)]))

    x, y, theta = frontier.pose
    assert x == pytest.approx(4.975)
    assert y == pytest.approx(3.5, abs=0.1)
    assert theta == pytest.approx(0.0, abs=0.1)
    assert frontier.path_m == pytest.approx(3.0, abs=0.1)
    assert frontier.width_m == pytest.approx(6.8)


def test_robot_looks_from_where_it_fits_whatever_the_unknown_hides() -> None:
    grid = room(unknown=[(5.0, 0.1, 8.9, 6.9)])
    x, y, theta = only(grid).view

    assert NEEDS.fits_m < 5.025 - x < NEEDS.fits_m + 0.1  # to the first unknown cell's center
    assert y == pytest.approx(3.5, abs=0.1)
    assert theta == pytest.approx(0.0, abs=0.1)


def test_opening_is_a_frontier_if_the_robot_fits_through() -> None:
    wide = only(behind_a_wall((3.0, 3.8)))
    assert wide.pose[0] == pytest.approx(5.075)
    assert wide.pose[1] == pytest.approx(3.4, abs=0.1)
    assert wide.view[0] < 4.9
    assert reach(behind_a_wall((3.0, 3.5))).frontiers == ()


def test_nearest_frontier_does_not_hide_the_others() -> None:
    found = reach(behind_a_wall((1.0, 1.8), (5.0, 5.8))).frontiers
    assert sorted(round(one.pose[1], 1) for one in found) == [1.4, 5.4]


def test_unknown_spot_smaller_than_the_robot_is_no_frontier() -> None:
    assert reach(room(unknown=[(4.0, 3.0, 4.4, 3.4)])).frontiers == ()
    assert len(reach(room(unknown=[(4.0, 3.0, 4.6, 3.6)])).frontiers) == 1


def test_ground_below_the_robot_is_no_frontier_and_does_not_enclose_it() -> None:
    spot: Box = (1.75, 3.25, 2.25, 3.75)
    assert reach(room(unknown=[spot])).frontiers == ()
    assert reach(room(unknown=[spot])).has(6.0, 2.0)


def test_frontier_in_the_map_is_the_same_in_any_frame() -> None:
    grid = room(unknown=[(5.0, 0.1, 8.9, 6.9)])
    origin = (-3.0, 1.0, 2.0)
    turned = Grid(grid.values, Frame(grid.frame.resolution, origin))

    moved = only(turned, compose(origin, HERE)).view

    np.testing.assert_allclose(moved[:2], compose(origin, only(grid).view)[:2], atol=1e-9)
    assert math.cos(moved[2] - 2.0) > 0.99


def test_enclosed_robot_reaches_nothing() -> None:
    grid = room(boxes=[(1.7, 3.2, 2.3, 3.8)])
    assert FrontierSearch().find(grid, HERE, NEEDS) is None


def test_frontiers_in_and_behind_keepout_zones_cannot_be_reached() -> None:
    grid = behind_a_wall((1.0, 1.8), (5.0, 5.8))
    cells = np.zeros(grid.values.shape, np.bool_)
    cells[90:130, 90:110] = True  # over the door at y = 5.4 m
    found = reach(grid, keepout=cells)
    assert [round(one.pose[1], 1) for one in found.frontiers] == [1.4]
    assert not found.has(4.3, 5.4)  # too near to the zone

    cells[:, 80:82] = True
    assert reach(grid, keepout=cells).frontiers == ()


def test_robot_in_a_keepout_zone_leaves_it_to_its_own_side_of_a_wall() -> None:
    grid = room(boxes=[(2.2, 0.0, 2.3, 7.0)], unknown=[(0.1, 0.1, 0.6, 6.9)])
    cells = np.zeros(grid.values.shape, np.bool_)
    cells[:, 28:46] = True
    found = reach(grid, (1.8, 3.5, 0.0), keepout=cells)
    assert len(found.frontiers) == 1
    assert found.has(1.0, 3.5)
    assert not found.has(3.0, 3.5)  # nearer, but behind the wall

    cells[:] = True
    assert FrontierSearch().find(grid, HERE, NEEDS, cells) is None


def frontier(x: float, path_m: float, width_m: float = 1.0) -> Frontier:
    pose = (x, 0.0, 0.0)
    return Frontier(pose, pose, path_m, width_m, np.array([[x, 0.0]]))


def test_near_and_wide_frontiers_come_first() -> None:
    near, far, wide = frontier(2.0, 2.0), frontier(9.0, 9.0), frontier(3.0, 3.0, 4.0)
    assert FrontierChoice().best([far, near]) is near
    assert FrontierChoice().best([far, near, wide]) is wide


def test_frontier_that_stays_is_tried_three_times_after_the_others() -> None:
    choice, near, far = FrontierChoice(), frontier(2.0, 2.0), frontier(9.0, 9.0)
    choice.failed(near)
    assert choice.best([near, far]) is far
    assert choice.best([near]) is near

    moved = frontier(2.4, 2.4)  # by a loop closure
    choice.failed(moved)
    choice.failed(near)
    assert choice.best([near]) is choice.best([moved]) is None
    assert choice.given_up([near, moved, far]) == 2
