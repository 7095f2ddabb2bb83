"""Cost maps: kept up by windows they are what they would be anew; the scanner's view on top."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.path_planner.cost_map import BLOCKED, CostMap, Costs, nearest_open
from cairn.components.path_planner.sightings import RecentObstacles
from cairn.planar.grid import Frame, OccupancyCells
from cairn.planar.scans import ScanBeams
from cairn.planar.shortest_path import CLOSED, MARGIN, MAX_COST, MIN_COST, open_costs
from tests.components.path_planner.rooms import room

COSTS = Costs(radius=0.22, reach=0.45, weight=1.0, margin=0.05, allow_unknown=False)
INNER = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]
FRAME = Frame(0.05)


def random_cells(seed: int, rows: int, columns: int) -> NDArray[np.int8]:
    rng = np.random.default_rng(seed)
    kinds = np.array([0, -1, 100, 40], np.int8)
    cells: NDArray[np.int8] = rng.choice(kinds, (rows, columns), p=[0.93, 0.02, 0.02, 0.03])
    return cells


def test_prices_fall_with_the_distance_from_an_obstacle() -> None:
    values = np.zeros((41, 41), np.int8)
    values[20, 20] = 100

    prices = CostMap(OccupancyCells(values, FRAME), COSTS).prices[INNER]

    row = prices[20, 20:]
    assert (row[:5] == BLOCKED).all()  # to 0.2 m: nearer than 0.22 + 0.025
    assert row[5] == CLOSED  # nearer than 0.05 more
    assert CLOSED > row[6] > row[8] > row[11] > MIN_COST
    assert (row[16:] == MIN_COST).all()
    assert row[6] <= 2 * MIN_COST


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    costs=st.sampled_from([COSTS, replace(COSTS, radius=0.01, reach=0.0)]),
    data=st.data(),
)
def test_windows_make_the_map_that_would_be_made_anew(
    seed: int, costs: Costs, data: st.DataObject
) -> None:
    before, after = random_cells(seed, 50, 70), random_cells(seed + 1, 50, 70)
    top = data.draw(st.integers(0, 49))
    left = data.draw(st.integers(0, 69))
    height, width = data.draw(st.integers(0, 50 - top)), data.draw(st.integers(0, 70 - left))
    window = np.s_[top : top + height, left : left + width]
    both = before.copy()
    both[window] = after[window]
    seen = np.random.default_rng(seed).integers(0, (50, 70), (20, 2))
    updated = CostMap(OccupancyCells(before, FRAME), costs)
    updated.overlay(seen)
    taken = CostMap(OccupancyCells(before, FRAME), costs)

    assert updated.update(top, left, after[window])
    assert taken.take(OccupancyCells(both, FRAME))

    anew = CostMap(OccupancyCells(both, FRAME), costs)
    np.testing.assert_array_equal(updated.map_prices, anew.map_prices)
    np.testing.assert_array_equal(taken.prices, anew.prices)
    anew.overlay(seen)
    np.testing.assert_array_equal(updated.prices, anew.prices)


def test_what_the_scanner_sees_closes_cells_when_the_map_holds_it_no_longer() -> None:
    post = room([(4.0, 3.0, 4.1, 3.1)])
    costs = CostMap(post, COSTS)
    costs.overlay(np.array([[60, 83]]))  # 0.1 m beside the post
    beside = (60 + MARGIN, 87 + MARGIN)
    assert costs.prices[beside] < CLOSED

    costs.update(60, 80, np.zeros((2, 2), np.int8))

    assert costs.prices[beside] == BLOCKED


def test_a_window_that_leaves_the_map_is_refused() -> None:
    costs = CostMap(room(), COSTS)

    assert not costs.update(138, 0, np.zeros((3, 1), np.int8))
    assert not costs.update(0, -1, np.zeros((3, 3), np.int8))
    assert not costs.take(room(size=(8.0, 7.0)))


def test_what_the_scanner_sees_closes_cells_like_an_obstacle_of_the_map_until_it_is_gone() -> None:
    box = room([(4.0, 3.0, 4.3, 3.3)])
    cells = np.argwhere(box.values != room().values)
    costs = CostMap(room(), COSTS)
    before = costs.prices.copy()

    costs.overlay(cells)
    np.testing.assert_array_equal(costs.prices, CostMap(box, COSTS).prices)
    costs.overlay(cells[:0])

    np.testing.assert_array_equal(costs.prices, before)


def test_near_where_the_robot_did_not_get_on_the_way_is_dear_and_no_more_closed() -> None:
    costs = CostMap(room(), COSTS)
    before = costs.prices.copy()

    costs.hinder([(4.0, 0.5), (99.0, 99.0)])  # beside a wall; outside the map
    near = costs.prices[10 + MARGIN, 80 + MARGIN : 89 + MARGIN].copy()
    closed = costs.prices >= CLOSED
    costs.hinder([])

    assert set(near.tolist()) == {MAX_COST}
    np.testing.assert_array_equal(closed, before >= CLOSED)
    np.testing.assert_array_equal(costs.prices, before)


def test_what_the_map_holds_anyway_is_not_laid_on_top() -> None:
    costs = CostMap(room(), COSTS)
    before = costs.prices.copy()

    costs.overlay(np.array([[70, 1], [70, 3], [70, 4]]))  # the wall is columns 0 and 1

    np.testing.assert_array_equal(costs.prices, before)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    share=st.floats(0, 1),
    row=st.floats(-20, 30),
    column=st.floats(-20, 30),
)
def test_the_nearest_open_cell_is_found(seed: int, share: float, row: float, column: float) -> None:
    prices = open_costs(11, 13)
    prices[INNER][np.random.default_rng(seed).random((11, 13)) < share] = 255
    opened = np.argwhere(prices[INNER] < CLOSED)

    found = nearest_open(prices, row, column)

    if len(opened) == 0:
        assert found is None
    else:
        assert found is not None
        apart = np.hypot(opened[:, 0] + 0.5 - row, opened[:, 1] + 0.5 - column).min()
        assert found[1] == pytest.approx(apart)
        assert prices[INNER][found[0]] < CLOSED


def beams(**ranges: float) -> ScanBeams:
    """Four beams: ahead, left, back, right; those not given see nothing in their way."""
    given_ = [ranges.get(name, math.inf) for name in ("ahead", "left", "back", "right")]
    angles = np.array([0.0, 0.5, 1.0, 1.5]) * math.pi
    return ScanBeams((0.0, 0.0, 0.0), angles, np.array(given_), 8.0)


def seen(obstacles: RecentObstacles) -> set[tuple[int, ...]]:
    return {tuple(cell) for cell in obstacles.cells().tolist()}


def test_what_was_seen_is_remembered_for_some_time_or_until_seen_through() -> None:
    obstacles = RecentObstacles(FRAME, (100, 100))
    here = (2.5, 2.5, 0.0)
    obstacles.see(0, here, beams(ahead=1.0, left=1.0, back=0.1, right=4.0), (0.22, 3.0), 3_000)
    assert seen(obstacles) == {(50, 70), (70, 50)}  # the others too near, and too far

    obstacles.see(1_000, here, beams(ahead=math.nan, left=2.0), (0.22, 3.0), 3_000)
    assert seen(obstacles) == {(50, 70), (90, 50)}

    obstacles.see(3_500, here, beams(ahead=math.nan, left=math.nan), (0.22, 3.0), 3_000)
    assert seen(obstacles) == {(90, 50)}

    obstacles.forget(2_000)
    assert seen(obstacles) == set()


def test_a_scanner_mounted_askew_and_clockwise_sees_the_same() -> None:
    here = (2.5, 2.5, 1.0)
    count = 36
    for sense in (1, -1):
        obstacles = RecentObstacles(FRAME, (100, 100))
        angles = 0.7 + sense * 2 * math.pi / count * np.arange(count, dtype=np.float64)
        ranges = np.full(count, 1.0)
        obstacles.see(0, here, ScanBeams((0.1, 0.0, 0.7), angles, ranges, 8.0), (0.22, 3.0), 10)
        assert len(seen(obstacles)) > 30
        obstacles.see(
            1, here, ScanBeams((0.1, 0.0, 0.7), angles, ranges + 0.3, 8.0), (0.22, 1.2), 10
        )
        assert seen(obstacles) == set()


def test_beams_that_all_point_the_same_way_are_taken_and_take_nothing_away() -> None:
    obstacles = RecentObstacles(FRAME, (100, 100))
    for stamp, range_m in ((0, 1.0), (1, 2.0)):
        same = ScanBeams((0.0, 0.0, 0.0), np.zeros(3), np.full(3, range_m), 8.0)
        obstacles.see(stamp, (2.5, 2.5, 0.0), same, (0.22, 3.0), 10)

    assert seen(obstacles) == {(50, 70), (50, 90)}


def test_weight_is_the_price_beside_an_obstacle() -> None:
    values = np.zeros((41, 41), np.int8)
    values[20, 20] = 100
    grid = OccupancyCells(values, FRAME)

    shortest = CostMap(grid, replace(COSTS, weight=0.0)).prices[INNER]
    dear = CostMap(grid, replace(COSTS, weight=3.0)).prices[INNER]

    assert set(np.unique(shortest)) == {MIN_COST, CLOSED, BLOCKED}
    assert 3.5 * MIN_COST < dear[20, 26] <= 4 * MIN_COST
