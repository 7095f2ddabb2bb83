"""Renewed places: which scans count there, and how a map is drawn with them."""

import math

import numpy as np
import pytest

from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN
from cairn.planar.renewals import Renewals
from cairn.planar.scan_grid import ScanGrid
from cairn.planar.scans import Rays

HERE = (0.0, 0.0, 0.0)


def wall_at(distance: float) -> Rays:
    """Rays to a wall ahead, 1 m wide."""
    angles = np.linspace(-math.atan2(0.5, distance), math.atan2(0.5, distance), 81)
    return Rays(np.zeros((81, 2)), angles, distance / np.cos(angles), 10.0)


def patches(left: float, bottom: float, right: float, top: float) -> np.ndarray:
    columns = np.arange(round(left / 0.1), round(right / 0.1))
    rows = np.arange(round(bottom / 0.1), round(top / 0.1))
    return np.array([(column, row) for column in columns for row in rows])


def cell(grid: ScanGrid, x: float, y: float) -> int:
    return int(grid.window(math.floor(y / 0.05), math.floor(x / 0.05), (1, 1))[0, 0])


def test_versions_of_points_cells_and_tiles_agree() -> None:
    renewals = Renewals().renewed(patches(-2.0, -0.5, 1.0, 0.3), 3)
    renewals = renewals.renewed(patches(0.5, 0.0, 3.0, 2.0), 5)
    random = np.random.default_rng(0)
    points = random.uniform(-3, 4, (500, 2))
    x, y = points.T
    wanted = np.zeros(500, np.int32)
    wanted[(x >= -2.0) & (x < 1.0) & (y >= -0.5) & (y < 0.3)] = 3
    wanted[(x >= 0.5) & (x < 3.0) & (y >= 0.0) & (y < 2.0)] = 5

    assert np.array_equal(renewals.since(points), wanted)
    cells = renewals.cells(-60, -60, (140, 140), 0.05)
    row, column = np.floor(y / 0.05).astype(int), np.floor(x / 0.05).astype(int)
    assert np.array_equal(cells[row + 60, column + 60], wanted)


def test_renewals_do_not_change() -> None:
    first = Renewals().renewed(patches(0.0, 0.0, 1.0, 1.0), 1)
    first.renewed(patches(0.0, 0.0, 1.0, 1.0), 2)

    assert first.since(np.array([[0.5, 0.5]])).tolist() == [1]


def test_older_version_is_refused() -> None:
    renewals = Renewals().renewed(patches(0.0, 0.0, 1.0, 1.0), 2)
    with pytest.raises(ValueError, match="version 1 is older"):
        renewals.renewed(patches(0.5, 0.5, 0.6, 0.6), 1)
    grid = ScanGrid(0.05, 10.0)
    grid.add(HERE, wall_at(2.0))
    grid.renew(renewals)
    with pytest.raises(ValueError, match="older version"):
        grid.renew(Renewals())


def test_renewed_place_is_drawn_by_newer_scans_alone() -> None:
    grid = ScanGrid(0.05, 10.0)
    for _ in range(5):
        grid.add(HERE, wall_at(2.02))
    assert cell(grid, 2.02, 0.0) == OCCUPIED

    grid.renew(Renewals().renewed(patches(1.5, -1.0, 3.5, 0.1), 1))
    assert cell(grid, 2.02, 0.0) == UNKNOWN
    assert cell(grid, 2.02, 0.32) == OCCUPIED, "beside the renewed place"
    grid.add(HERE, wall_at(3.02), 1)

    assert cell(grid, 2.02, 0.0) == FREE
    assert cell(grid, 3.02, 0.0) == OCCUPIED


def test_old_scan_is_removed_without_a_trace_in_renewed_places() -> None:
    grid, only_new = ScanGrid(0.05, 10.0), ScanGrid(0.05, 10.0)
    renewals = Renewals().renewed(patches(1.5, -1.0, 3.5, 0.1), 1)
    grid.add(HERE, wall_at(2.02))
    grid.renew(renewals)
    grid.add(HERE, wall_at(3.02), 1)
    only_new.renew(renewals)
    only_new.add(HERE, wall_at(3.02), 1)

    grid.remove(HERE, wall_at(2.02))

    assert np.array_equal(grid.whole().values, only_new.whole().values)


def test_map_that_grows_keeps_its_renewed_places() -> None:
    grid = ScanGrid(0.05, 10.0)
    grid.renew(Renewals().renewed(patches(7.0, -0.5, 8.0, 0.5), 1))
    grid.add(HERE, wall_at(2.02), 1)

    grid.add(HERE, wall_at(7.52))

    assert cell(grid, 7.52, 0.0) == UNKNOWN
    assert cell(grid, 6.0, 0.0) == FREE


def test_change_without_a_scan_counts_what_only_it_shows() -> None:
    grid = ScanGrid(0.05, 10.0)
    grid.add(HERE, wall_at(2.02))
    grid.add(HERE, wall_at(2.02))
    before = grid.whole().values

    assert grid.change_without(HERE, wall_at(2.02)) == 0
    grid.remove(HERE, wall_at(2.02))
    assert grid.change_without(HERE, wall_at(2.02)) > 100
    grid.add(HERE, wall_at(2.02))
    assert np.array_equal(grid.whole().values, before)


def test_changes_of_renewed_places_are_reported() -> None:
    grid = ScanGrid(0.05, 10.0)
    grid.add(HERE, wall_at(2.02))
    grid.take_changes()

    grid.renew(Renewals().renewed(patches(2.0, 0.0, 2.1, 0.1), 1))

    changes = grid.take_changes()
    assert changes is not None
    assert changes[2].shape == (2, 2)
    assert (changes[2] == UNKNOWN).all()
