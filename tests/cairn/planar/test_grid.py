"""Grids: the distance field is exact and reproducible."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from cairn.planar.grid import Frame, Grid, distance_field, grid_of, map_message
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.std_msgs import Header


@given(arrays.arrays(np.bool_, arrays.array_shapes(min_dims=2, max_dims=2, max_side=20)))
def test_distance_field_is_the_distance_to_the_nearest_obstacle(
    obstacles: NDArray[np.bool_],
) -> None:
    field = distance_field(obstacles, 0.05)

    places = np.argwhere(obstacles)
    if not len(places):
        assert np.all(np.isinf(field))
        return
    cells = np.argwhere(np.ones_like(obstacles))
    squares = np.square(cells[:, None, :] - places[None, :, :]).sum(axis=2).min(axis=1)
    nearest = np.sqrt(squares.astype(np.float32)) * np.float32(0.05)
    assert np.array_equal(field.ravel(), nearest)


@given(st.integers(0, 63), st.integers(0, 2**32 - 1))
def test_distance_field_does_not_depend_on_memory_addresses(offset: int, seed: int) -> None:
    obstacles = np.random.default_rng(seed).random((39, 47)) < 0.02
    moved = np.empty(obstacles.size + offset, np.bool_)[offset:].reshape(obstacles.shape)
    moved[:] = obstacles

    assert distance_field(moved, 0.05).tobytes() == distance_field(obstacles, 0.05).tobytes()


def test_cells_and_points_of_a_rotated_grid_correspond() -> None:
    frame = Frame(0.1, (1.0, 2.0, math.pi / 6))
    for row, column in ((0, 0), (3, 7), (-2, 5)):
        assert frame.cell(*frame.point(row, column)) == (row, column)


def test_map_survives_conversion_to_a_message_and_back() -> None:
    grid = Grid(np.arange(12, dtype=np.int8).reshape(3, 4), Frame(0.05, (-1.0, 0.5, 0.2)))

    again = grid_of(map_message(Header(frame_id="map"), grid, Time()))

    assert np.array_equal(again.values, grid.values)
    assert again.frame.origin == pytest.approx(grid.frame.origin)
    assert again.frame.resolution == pytest.approx(0.05)
    assert again.holds(2, 3)
    assert not again.holds(3, 0)
