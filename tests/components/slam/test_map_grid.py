"""Tests of the grid map of a graph: it follows the poses of the keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from cairn.components.slam.map_grid import MapGrid
from cairn.components.slam.mapping import Mapper
from tests.components.slam.box_room import drive


@pytest.fixture
def mapper() -> Mapper:
    mapper = Mapper(10.0)
    drive(mapper, 0, 30)
    return mapper


def fresh(mapper: Mapper, shown: np.ndarray) -> MapGrid:
    drawing = MapGrid(0.05, 10.0)
    drawing.update(mapper.keyframes, mapper.graph.poses, shown)
    return drawing


def test_map_is_drawn_anew_where_poses_have_changed(mapper: Mapper) -> None:
    shown = mapper.in_map()
    drawing = fresh(mapper, shown)
    assert not drawing.update(mapper.keyframes, mapper.graph.poses, shown)
    mapper.graph.poses[4:, 0] += 0.1

    assert drawing.update(mapper.keyframes, mapper.graph.poses, shown)

    expected = fresh(mapper, shown).counts.grid()
    assert np.array_equal(drawing.counts.grid().values, expected.values)


def test_bounded_calls_reach_the_same_map(mapper: Mapper) -> None:
    shown = mapper.in_map()
    drawing, calls = MapGrid(0.05, 10.0), 0

    while drawing.update(mapper.keyframes, mapper.graph.poses, shown, most=2):
        calls += 1

    assert calls == -(-len(mapper.keyframes) // 2)
    assert np.array_equal(drawing.counts.grid().values, fresh(mapper, shown).counts.grid().values)


def test_keyframes_outside_of_the_map_are_not_drawn(mapper: Mapper) -> None:
    drawing = fresh(mapper, mapper.in_map())
    shown = mapper.in_map().copy()
    shown[6:] = False

    drawing.update(mapper.keyframes, mapper.graph.poses, shown)

    assert np.array_equal(drawing.counts.grid().values, fresh(mapper, shown).counts.grid().values)
