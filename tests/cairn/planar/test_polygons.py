"""Polygons: cells and points inside, edges that cross."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.planar.grid import Frame
from cairn.planar.polygons import (
    cells_along,
    covered_cells,
    crossing,
    distance_to_edges,
    edges_of,
    inside_cells,
    is_inside,
    points_near,
)

NUMBERS = st.floats(-4, 4)
SQUARE = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
HOLE = [(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)]


def edges(*rings: list[tuple[float, float]], closed: bool = True) -> np.ndarray:
    points = np.array([point for ring in rings for point in ring])
    return edges_of(points, np.array([len(ring) for ring in rings], np.uint32), closed=closed)


@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=3, max_size=8), NUMBERS, NUMBERS, NUMBERS)
def test_inside_cells_are_those_whose_centers_are_inside(
    corners: list[tuple[float, float]], x: float, y: float, theta: float
) -> None:
    polygon, frame = edges(corners), Frame(0.31, (x, y, theta))
    cells = inside_cells(polygon, frame, (20, 17))
    for (row, column), marked in np.ndenumerate(cells):
        center = frame.point(row, column)
        if distance_to_edges(polygon, *center) > 1e-9:
            assert marked == is_inside(polygon, *center)


@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=3, max_size=6), st.floats(0, 1))
def test_every_point_of_an_edge_is_in_a_covered_cell(
    corners: list[tuple[float, float]], share: float
) -> None:
    polygon, frame = edges(corners), Frame(0.25, (-5.03, -5.01, 0.0))
    cells = covered_cells(polygon, frame, (41, 41))
    for x0, y0, x1, y1 in polygon.tolist():
        x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        column, row = frame.cells(x, y)
        # Rounding may put a point on the border of a cell into its neighbor.
        around = cells[
            math.floor(row - 1e-9) : math.floor(row + 1e-9) + 1,
            math.floor(column - 1e-9) : math.floor(column + 1e-9) + 1,
        ]
        assert around.any()


def test_polygon_thinner_than_a_cell_covers_cells() -> None:
    thin = edges([(0.11, 0.02), (0.12, 0.02), (0.12, 1.4), (0.11, 1.4)])
    assert not inside_cells(thin, Frame(0.1), (20, 20)).any()
    assert covered_cells(thin, Frame(0.1), (20, 20))[:14, 1].all()


def test_hole_is_outside() -> None:
    ring = edges(SQUARE, HOLE)
    assert is_inside(ring, 0.25, 1.0)
    assert not is_inside(ring, 1.0, 1.0)
    assert not inside_cells(ring, Frame(0.1), (20, 20))[10, 10]


def test_polygon_far_outside_the_grid_covers_nothing() -> None:
    far = edges([(1e5, 1e5), (1e5, 9e4), (9e4, 9e4)])
    assert not covered_cells(far, Frame(0.05), (10, 10)).any()


def test_polygon_around_the_grid_covers_all() -> None:
    around = edges([(-1e5, -1e5), (1e5, -1e5), (1e5, 1e5), (-1e5, 1e5)])
    assert covered_cells(around, Frame(0.05), (10, 10)).all()


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.floats(0.05, 1))
def test_cells_along_a_line_are_those_near_it(
    x0: float, y0: float, x1: float, y1: float, half: float
) -> None:
    line = edges([(x0, y0), (x1, y1)], closed=False)
    frame = Frame(0.25, (-3.0, -3.0, 0.0))
    cells = cells_along(line, half, frame, (24, 24))
    for (row, column), marked in np.ndenumerate(cells):
        apart = distance_to_edges(line, *frame.point(row, column))
        if abs(apart - half) > 1e-9:
            assert marked == (apart < half)


@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=3, max_size=6), NUMBERS, NUMBERS)
def test_points_near_are_on_edges_and_dense(
    corners: list[tuple[float, float]], x: float, y: float
) -> None:
    polygon = edges(corners)
    points = points_near(polygon, x, y, 2.0, 0.1)
    for px, py in points.tolist():
        assert math.hypot(px - x, py - y) <= 2.0 + 1e-6
        assert distance_to_edges(polygon, px, py) < 1e-6
    nearest = distance_to_edges(polygon, x, y)
    lengths = np.hypot(polygon[:, 2] - polygon[:, 0], polygon[:, 3] - polygon[:, 1])
    if nearest < 1.9 and lengths.min() > 0.1:
        found = np.hypot(points[:, 0] - x, points[:, 1] - y).min()
        assert found == pytest.approx(nearest, abs=0.05)


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (1, 1), (1, 0), (0, 1)],
        [(0, 0), (1, 0), (1, 0), (1, 1)],
        [(0, 0), (2, 0), (1, 0), (1, 1)],
        [(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)],
        [(0, 0), (1, 1), (2, 2)],
    ],
    ids=["bow tie", "corner twice", "way back", "corner on an edge", "no area"],
)
def test_edges_that_cross_are_found(corners: list[tuple[float, float]]) -> None:
    assert crossing(edges([(float(x), float(y)) for x, y in corners])) is not None


def test_simple_polygon_has_no_crossing() -> None:
    assert crossing(edges(SQUARE, HOLE)) is None
    assert crossing(edges([(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (2.0, 1.0), (0.0, 3.0)])) is None


def test_hole_that_crosses_the_outline_is_found() -> None:
    shifted = [(x + 1.0, y) for x, y in HOLE]
    assert crossing(edges(SQUARE, shifted)) is not None
