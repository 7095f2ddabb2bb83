"""A robot's map is compared with the world in whatever frame it is, and aligned with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cairn.components.simulation.survey import surveyed_grid
from cairn.planar.grid import OCCUPIED, UNKNOWN, Grid, OccupancyCells
from cairn.planar.map_file import read_map, write_map
from cairn.planar.poses import Pose, compose, inverse
from cairn_lab.evaluation.map_comparison import WALL_M, compare_with_world, placed_map
from cairn_lab.evaluation.runs import align

WORLD = Path(__file__).parents[3] / "deploy" / "worlds" / "room.yaml"
FRAME: Pose = (1.0, 1.0, 0.3)
SLIPPED = compose(FRAME, (0.04, -0.03, 0.01))


@pytest.fixture(scope="module")
def true_map() -> OccupancyCells:
    return surveyed_grid(WORLD)


def in_frame(grid: OccupancyCells, frame: Pose) -> OccupancyCells:
    """The map as one whose frame has that pose in the world."""
    return placed_map(grid, inverse(frame))


def test_true_map_agrees_in_any_frame_and_its_frame_is_found(true_map: OccupancyCells) -> None:
    compared = compare_with_world(in_frame(true_map, SLIPPED), WORLD, FRAME, 0.22)

    np.testing.assert_allclose(compared.pose, SLIPPED, atol=0.003)
    assert compared.within(WALL_M) == 1.0
    assert compared.known == 1.0


def test_unknown_part_and_wrong_walls_are_counted(true_map: OccupancyCells) -> None:
    values = true_map.values.copy()
    columns = values.shape[1]
    values[:, : columns // 4] = UNKNOWN
    walls = np.count_nonzero(values == OCCUPIED)
    row, column = true_map.frame.cell(6.5, 2.0)
    values[row : row + 10, column : column + 10] = OCCUPIED
    changed = Grid(values, true_map.frame)

    compared = compare_with_world(changed, WORLD, (0.0, 0.0, 0.0), 0.22)

    assert 0.7 < compared.known < 0.85
    assert compared.within(WALL_M) == pytest.approx(walls / (walls + 100), abs=0.01)


def test_map_that_begins_at_the_robot_is_aligned_with_the_world(
    true_map: OccupancyCells, tmp_path: Path
) -> None:
    made, aligned = tmp_path / "made.yaml", tmp_path / "aligned.yaml"
    write_map(made, in_frame(true_map, (1.0, 1.0, 0.0)))

    text = align(made, WORLD, aligned)

    assert "100.0% of its walls are within 5 cm" in text
    np.testing.assert_allclose(read_map(aligned).frame.origin, true_map.frame.origin, atol=0.005)
