"""Paths pulled taut, resampled and rounded: shorter, smooth, and never over closed cells."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.planar.path_shape import cell_centers, first_closed_segment, pull_taut, resampled
from cairn.planar.shortest_path import CLOSED, MARGIN, MIN_COST, CellCosts, PathSearch, open_costs
from tests.cairn.planar.any_angle import clear, cost_along

INNER = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]


def with_wall() -> CellCosts:
    """20 x 20 cells with a wall in column 10 from row 5 down."""
    prices = open_costs(20, 20)
    prices[INNER][5:, 10] = 255
    return prices


def turns(points: NDArray[np.float64]) -> NDArray[np.float64]:
    steps = np.diff(points, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    turned: NDArray[np.float64] = (np.diff(headings) + math.pi) % (2 * math.pi) - math.pi
    return np.abs(turned)


@pytest.mark.parametrize(("price", "goes_around"), [(MIN_COST, False), (12 * MIN_COST, True)])
def test_path_is_shortened_only_over_cells_that_are_cheap_enough(
    price: int, goes_around: bool
) -> None:
    prices = open_costs(20, 20)
    prices[INNER][8:, 8:12] = price
    bow = np.array([[4.5, 12.5], [4.5, 4.5], [15.5, 4.5], [15.5, 12.5]])

    line = pull_taut(prices, bow)

    assert (len(line) > 2) == goes_around
    assert cost_along(prices, line) < (19.5 if goes_around else 11.0 + 1e-6)


def test_first_closed_segment_is_returned() -> None:
    points = np.array([[2.5, 8.5], [6.5, 8.5], [12.5, 8.5], [9.5, 8.5]])

    assert first_closed_segment(with_wall(), points) == 1
    assert first_closed_segment(with_wall(), points[:2]) == -1


@pytest.mark.parametrize(
    ("x", "y"), [(-6.5, 3.5), (26.5, 3.5), (3.5, -6.5), (3.5, 26.5), (math.nan, 3.5), (1e300, 3.5)]
)
def test_everything_outside_the_grid_is_closed(x: float, y: float) -> None:
    memory = np.full(100 * 24, MIN_COST, np.uint8)
    prices = memory[: 24 * 24].reshape(24, 24)
    points = np.array([[2.5, 2.5], [4.5, 2.5], [x, y], [x + 1.0, y]])

    assert first_closed_segment(prices, points[:2]) == -1
    assert first_closed_segment(prices, points[2:]) == 0
    assert first_closed_segment(prices, points) == 1


def test_line_through_a_corner_touches_both_cells() -> None:
    prices = open_costs(4, 4)
    prices[INNER][0, 1] = 255
    line = np.array([[0.5, 0.5], [1.5, 1.5]])

    assert first_closed_segment(prices, line) == 0


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0, 0.35), dear=st.booleans())
def test_shaped_path_touches_no_closed_cell_and_is_not_more_expensive(
    seed: int, share: float, dear: bool
) -> None:
    rng = np.random.default_rng(seed)
    prices = open_costs(24, 24)
    if dear:
        prices[INNER] = rng.integers(MIN_COST, 3 * MIN_COST, (24, 24))
    prices[INNER][rng.random((24, 24)) < share] = 255
    prices[INNER][0, 0] = prices[INNER][23, 23] = MIN_COST
    cells = PathSearch(prices.shape).find(prices, (0, 0), (23, 23)).cells
    if cells is None:
        return
    points = cell_centers(cells)

    line = pull_taut(prices, points)
    path = resampled(prices, line, 2.0)

    closed = prices[INNER] >= CLOSED
    for shape in (line, path):
        np.testing.assert_array_equal(shape[[0, -1]], points[[0, -1]])
        assert all(clear(closed, a, b, rim=1e-6) for a, b in pairwise(shape))
    assert cost_along(prices, line) <= cost_along(prices, points) + 1e-6


def test_steps_are_even_and_corners_are_rounded_where_there_is_room() -> None:
    prices = open_costs(60, 60)
    corner = np.array([[5.0, 5.0], [5.0, 45.0], [45.0, 45.0]])

    path = resampled(prices, corner, 2.0)

    assert np.hypot(*np.diff(path, axis=0).T).max() <= 2.0 + 1e-9
    assert turns(path).max() < 0.45 < math.pi / 2


def test_path_of_one_point_stays_there() -> None:
    here = np.array([[3.5, 3.5], [3.5, 3.5]])

    np.testing.assert_array_equal(pull_taut(open_costs(9, 9), here)[[0, -1]], here)
    np.testing.assert_array_equal(resampled(open_costs(9, 9), here, 2.0)[[0, -1]], here)
