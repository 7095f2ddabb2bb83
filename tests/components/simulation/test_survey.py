"""Surveyed maps agree with the world file."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.components.simulation.survey import (
    RESOLUTION,
    grid_of_world,
    surveyed_grid,
    surveyed_objects,
)
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN
from cairn.planar.poses import compose
from tests.components.simulation.worlds import box, world_file
from tests.wording import words_in_order

WORLDS = Path(__file__).parents[3] / "deploy" / "worlds"


@pytest.mark.parametrize("name", ["room", "office", "hall"])
def test_walls_are_closed_and_cells_beyond_them_are_unknown(name: str) -> None:
    grid = surveyed_grid(WORLDS / f"{name}.yaml")

    edge = np.concatenate((grid.values[[0, -1]].ravel(), grid.values[:, [0, -1]].ravel()))
    assert set(np.unique(edge)) == {UNKNOWN}
    free = grid.values == FREE
    for step in (1, -1):
        for axis in (0, 1):
            beside = np.roll(grid.values, step, axis)[free]
            assert not np.any(beside == UNKNOWN)


@given(st.floats(-3.1, 3.1), st.floats(0.3, 2.5), st.floats(0.05, 1.5))
@settings(max_examples=30, deadline=None)
def test_outlines_are_occupied_and_their_inside_is_not_free(
    theta: float, width: float, depth: float
) -> None:
    piece = {"name": "it", "x": 1.6, "y": 2.0, "theta": theta, "size": [width, depth]}
    robot = {"x": 5.5, "y": 3.5}
    grid = grid_of_world(world_file(furniture=[piece], robot=robot))

    for share in np.linspace(-0.5, 0.5, 41).tolist():
        for x, y in ((share * width, 0.5 * depth), (0.5 * width, share * depth)):
            there = compose((1.6, 2.0, theta), (x, y, 0.0))
            row, column = grid.frame.cell(there[0], there[1])
            # Where the wall only cuts a corner of the cell, the next cell is occupied.
            near = grid.values[row - 1 : row + 2, column - 1 : column + 2]
            assert OCCUPIED in near
            assert grid.values[row, column] != FREE or np.sum(near == OCCUPIED) >= 2
    assert grid.values[grid.frame.cell(1.6, 2.0)] != FREE


def test_walls_pass_through_the_middle_of_cells() -> None:
    grid = grid_of_world(world_file())
    row, column = grid.frame.cell(0.0, 2.0)

    assert grid.values[row, column] == OCCUPIED
    assert grid.frame.point(row, column)[0] == pytest.approx(0.0, abs=1e-9)
    assert grid.values[row, column + 1] == FREE
    assert grid.values[row, column - 1] == UNKNOWN


@pytest.mark.parametrize("resolution", [0.02, 0.1, 0.2])
def test_cells_have_the_requested_size(resolution: float) -> None:
    grid = grid_of_world(world_file(), resolution)

    assert grid.frame.resolution == resolution
    row, column = grid.frame.cell(0.0, 2.0)
    assert grid.values[row, column] == OCCUPIED
    assert grid.values[row, column + 1] == FREE
    assert np.count_nonzero(grid.values == FREE) * resolution**2 == pytest.approx(24.0, rel=0.1)


def test_cells_too_large_for_the_robots_start_are_rejected() -> None:
    with pytest.raises(CairnError, match=words_in_order("cells of 1 m", "robot", "occupied")):
        grid_of_world(world_file(robot={"x": 0.4, "y": 2.0}), 1.0)


def test_gap_in_the_walls_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "open.yaml"
    walls = [{"points": [[0, 0], [6, 0], [6, 4], [0, 4], [0, 3 * RESOLUTION]]}]
    file.write_text(yaml.safe_dump(box(walls=walls)))

    with pytest.raises(
        CairnError, match=words_in_order("gap of 0.15 m", "(0.00, 0.00)", "(0.00, 0.15)")
    ):
        surveyed_grid(file)


def test_objects_are_mapped_at_their_initial_poses(tmp_path: Path) -> None:
    file = tmp_path / "world.yaml"
    things = [{"id": 4, "x": 0, "y": 1.0}, {"id": 7, "name": "door", "x": 6, "y": 2, "theta": 3.1}]
    file.write_text(yaml.safe_dump(box(objects=things)))

    found = surveyed_objects(file).objects

    assert [(one.object_id, one.name, one.x, one.y) for one in found] == [
        (4, "object_4", 0.0, 1.0),
        (7, "door", 6.0, 2.0),
    ]
