"""Cost maps: updated windows equal a new map; obstacles of the scanner are inflated on top."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.path_planner.cost_map import BLOCKED, CostMap, CostParameters, nearest_open
from cairn.components.path_planner.unmapped_obstacles import RecentObstacles
from cairn.planar.grid import Frame, OccupancyCells
from cairn.planar.scans import ScanBeams
from cairn.planar.shortest_path import CLOSED, MARGIN, MAX_COST, MIN_COST, open_costs
from tests.components.path_planner.rooms import room

COSTS = CostParameters(
    radius=0.22,
    inflation_distance=0.45,
    inflation_weight=1.0,
    margin=0.05,
    allow_unknown=False,
)
INNER = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]
FRAME = Frame(0.05)


def random_cells(seed: int, rows: int, columns: int) -> NDArray[np.int8]:
    rng = np.random.default_rng(seed)
    kinds = np.array([0, -1, 100, 40], np.int8)
    cells: NDArray[np.int8] = rng.choice(kinds, (rows, columns), p=[0.93, 0.02, 0.02, 0.03])
    return cells


def test_costs_decrease_with_the_distance_from_an_obstacle() -> None:
    values = np.zeros((41, 41), np.int8)
    values[20, 20] = 100

    cell_costs = CostMap(OccupancyCells(values, FRAME), COSTS).cell_costs[INNER]

    row = cell_costs[20, 20:]
    assert (row[:5] == BLOCKED).all()  # to 0.2 m: nearer than 0.22 + 0.025
    assert row[5] == CLOSED  # nearer than 0.05 more
    assert CLOSED > row[6] > row[8] > row[11] > MIN_COST
    assert (row[16:] == MIN_COST).all()
    assert row[6] <= 2 * MIN_COST


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    costs=st.sampled_from([COSTS, replace(COSTS, radius=0.01, inflation_distance=0.0)]),
    data=st.data(),
)
def test_updated_windows_give_the_same_costs_as_a_new_map(
    seed: int, costs: CostParameters, data: st.DataObject
) -> None:
    before, after = random_cells(seed, 50, 70), random_cells(seed + 1, 50, 70)
    top = data.draw(st.integers(0, 49))
    left = data.draw(st.integers(0, 69))
    height, width = data.draw(st.integers(0, 50 - top)), data.draw(st.integers(0, 70 - left))
    window = np.s_[top : top + height, left : left + width]
    both = before.copy()
    both[window] = after[window]
    obstacles = np.random.default_rng(seed).integers(0, (50, 70), (20, 2))
    updated = CostMap(OccupancyCells(before, FRAME), costs)
    updated.set_scanner_obstacles(obstacles)
    taken = CostMap(OccupancyCells(before, FRAME), costs)

    assert updated.update(top, left, after[window])
    assert taken.replace_map(OccupancyCells(both, FRAME))

    rebuilt = CostMap(OccupancyCells(both, FRAME), costs)
    np.testing.assert_array_equal(updated.map_costs, rebuilt.map_costs)
    np.testing.assert_array_equal(taken.cell_costs, rebuilt.cell_costs)
    rebuilt.set_scanner_obstacles(obstacles)
    np.testing.assert_array_equal(updated.cell_costs, rebuilt.cell_costs)


def test_obstacle_of_the_scanner_closes_cells_once_the_map_no_longer_has_it() -> None:
    post = room([(4.0, 3.0, 4.1, 3.1)])
    costs = CostMap(post, COSTS)
    costs.set_scanner_obstacles(np.array([[60, 83]]))  # 0.1 m beside the post
    beside = (60 + MARGIN, 87 + MARGIN)
    assert costs.cell_costs[beside] < CLOSED

    costs.update(60, 80, np.zeros((2, 2), np.int8))

    assert costs.cell_costs[beside] == BLOCKED


def test_window_outside_the_map_is_rejected() -> None:
    costs = CostMap(room(), COSTS)

    assert not costs.update(138, 0, np.zeros((3, 1), np.int8))
    assert not costs.update(0, -1, np.zeros((3, 3), np.int8))
    assert not costs.replace_map(room(size=(8.0, 7.0)))


def test_obstacle_of_the_scanner_is_inflated_like_one_of_the_map_until_it_is_gone() -> None:
    box = room([(4.0, 3.0, 4.3, 3.3)])
    cells = np.argwhere(box.values != room().values)
    costs = CostMap(room(), COSTS)
    before = costs.cell_costs.copy()

    costs.set_scanner_obstacles(cells)
    np.testing.assert_array_equal(costs.cell_costs, CostMap(box, COSTS).cell_costs)
    costs.set_scanner_obstacles(cells[:0])

    np.testing.assert_array_equal(costs.cell_costs, before)


def test_avoided_position_raises_costs_without_closing_cells() -> None:
    costs = CostMap(room(), COSTS)
    before = costs.cell_costs.copy()

    costs.set_avoided_positions([(4.0, 0.5), (99.0, 99.0)])  # beside a wall; outside the map
    near = costs.cell_costs[10 + MARGIN, 80 + MARGIN : 89 + MARGIN].copy()
    closed = costs.cell_costs >= CLOSED
    costs.set_avoided_positions([])

    assert set(near.tolist()) == {MAX_COST}
    np.testing.assert_array_equal(closed, before >= CLOSED)
    np.testing.assert_array_equal(costs.cell_costs, before)


def test_obstacles_of_the_map_seen_by_the_scanner_change_nothing() -> None:
    costs = CostMap(room(), COSTS)
    before = costs.cell_costs.copy()

    costs.set_scanner_obstacles(
        np.array([[70, 1], [70, 3], [70, 4]])
    )  # the wall is columns 0 and 1

    np.testing.assert_array_equal(costs.cell_costs, before)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    share=st.floats(0, 1),
    row=st.floats(-20, 30),
    column=st.floats(-20, 30),
)
def test_nearest_open_cell_is_found(seed: int, share: float, row: float, column: float) -> None:
    cell_costs = open_costs(11, 13)
    cell_costs[INNER][np.random.default_rng(seed).random((11, 13)) < share] = 255
    opened = np.argwhere(cell_costs[INNER] < CLOSED)

    found = nearest_open(cell_costs, row, column)

    if len(opened) == 0:
        assert found is None
    else:
        assert found is not None
        apart = np.hypot(opened[:, 0] + 0.5 - row, opened[:, 1] + 0.5 - column).min()
        assert found[1] == pytest.approx(apart)
        assert cell_costs[INNER][found[0]] < CLOSED


def beams(**ranges: float) -> ScanBeams:
    """Four beams: ahead, left, back, right; beams without a value hit nothing."""
    given_ = [ranges.get(name, math.inf) for name in ("ahead", "left", "back", "right")]
    angles = np.array([0.0, 0.5, 1.0, 1.5]) * math.pi
    return ScanBeams((0.0, 0.0, 0.0), angles, np.array(given_), 8.0)


def occupied_cells(obstacles: RecentObstacles) -> set[tuple[int, ...]]:
    return {tuple(cell) for cell in obstacles.cells().tolist()}


def test_obstacles_are_remembered_for_some_time_or_until_seen_through() -> None:
    obstacles = RecentObstacles(FRAME, (100, 100))
    here = (2.5, 2.5, 0.0)
    obstacles.add_scan(0, here, beams(ahead=1.0, left=1.0, back=0.1, right=4.0), (0.22, 3.0), 3_000)
    assert occupied_cells(obstacles) == {(50, 70), (70, 50)}  # the others too near, and too far

    obstacles.add_scan(1_000, here, beams(ahead=math.nan, left=2.0), (0.22, 3.0), 3_000)
    assert occupied_cells(obstacles) == {(50, 70), (90, 50)}

    obstacles.add_scan(3_500, here, beams(ahead=math.nan, left=math.nan), (0.22, 3.0), 3_000)
    assert occupied_cells(obstacles) == {(90, 50)}

    obstacles.forget(2_000)
    assert occupied_cells(obstacles) == set()


def test_rotated_and_clockwise_scanner_sees_the_same() -> None:
    here = (2.5, 2.5, 1.0)
    count = 36
    for sense in (1, -1):
        obstacles = RecentObstacles(FRAME, (100, 100))
        angles = 0.7 + sense * 2 * math.pi / count * np.arange(count, dtype=np.float64)
        ranges = np.full(count, 1.0)
        obstacles.add_scan(
            0, here, ScanBeams((0.1, 0.0, 0.7), angles, ranges, 8.0), (0.22, 3.0), 10
        )
        assert len(occupied_cells(obstacles)) > 30
        obstacles.add_scan(
            1, here, ScanBeams((0.1, 0.0, 0.7), angles, ranges + 0.3, 8.0), (0.22, 1.2), 10
        )
        assert occupied_cells(obstacles) == set()


def test_beams_in_one_direction_add_obstacles_and_remove_none() -> None:
    obstacles = RecentObstacles(FRAME, (100, 100))
    for stamp, range_m in ((0, 1.0), (1, 2.0)):
        same = ScanBeams((0.0, 0.0, 0.0), np.zeros(3), np.full(3, range_m), 8.0)
        obstacles.add_scan(stamp, (2.5, 2.5, 0.0), same, (0.22, 3.0), 10)

    assert occupied_cells(obstacles) == {(50, 70), (50, 90)}


def test_inflation_weight_is_the_additional_cost_beside_an_obstacle() -> None:
    values = np.zeros((41, 41), np.int8)
    values[20, 20] = 100
    grid = OccupancyCells(values, FRAME)

    shortest = CostMap(grid, replace(COSTS, inflation_weight=0.0)).cell_costs[INNER]
    dear = CostMap(grid, replace(COSTS, inflation_weight=3.0)).cell_costs[INNER]

    assert set(np.unique(shortest)) == {MIN_COST, CLOSED, BLOCKED}
    assert 3.5 * MIN_COST < dear[20, 26] <= 4 * MIN_COST
