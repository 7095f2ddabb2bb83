"""Tests of grid maps from scans with poses."""

import math

import numpy as np
import pytest

from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, OccupancyCells, distance_field
from cairn.planar.poses import Pose
from cairn.planar.scan_grid import SEEN_FREE, ScanGrid, build_grid
from cairn.planar.scans import Rays, rays_of
from cairn.schemas.sensor_msgs import LaserScan
from tests.components.localizer.room import Box, room, scanned

STEP = math.radians(0.5)
LENGTH = 16.0


def corridor() -> OccupancyCells:
    """Return a corridor, 2 m wide, between two blocks."""
    blocks: tuple[Box, ...] = ((0.0, 0.0, LENGTH, 1.0), (0.0, 3.0, LENGTH, 4.0))
    return room(blocks, LENGTH, 4.0)


def drive(grid: OccupancyCells, seed: int) -> list[tuple[Pose, LaserScan]]:
    """Return scans along the corridor, with pose errors of 7 cm and a degree."""
    random = np.random.default_rng(seed)
    posed = []
    for x in np.arange(0.5, LENGTH - 0.5, 0.25):
        true = (float(x), 2.0, 0.0 if random.random() < 0.5 else math.pi)
        points = scanned(grid, true, random, math.radians(180), 361, 15.0, 0.02)
        ranges = np.full(361, np.inf, np.float32)
        places = np.rint((np.arctan2(points[:, 1], points[:, 0]) + math.pi / 2) / STEP)
        ranges[np.clip(places.astype(int), 0, 360)] = np.hypot(points[:, 0], points[:, 1])
        off = 0.07 * random.standard_normal(2)
        turned = 0.02 * random.standard_normal()
        scan = LaserScan(
            angle_min=-math.pi / 2,
            angle_max=math.pi / 2,
            angle_increment=STEP,
            range_min=0.05,
            range_max=20.0,
            ranges=ranges,
        )
        posed.append(((true[0] + off[0], true[1] + off[1], true[2] + turned), scan))
    return posed


def test_corridor_walls_are_complete_and_the_space_between_is_free() -> None:
    grid = corridor()

    drawn = build_grid(drive(grid, 0), 0.05, (0.0, 0.0, 0.0), 15.0)

    found = np.array([drawn.frame.point(r, c) for r, c in np.argwhere(drawn.values == OCCUPIED)])
    for wall_y in (1.0, 3.0):
        along = np.arange(1.0, LENGTH - 1.0, 0.05)
        near = found[np.abs(found[:, 1] - wall_y) < 0.12]
        gaps = np.abs(near[:, 0] - along[:, None]).min(axis=1)
        assert np.mean(gaps < 0.05) > 0.95
    to_wall = distance_field(np.asarray(grid.values == OCCUPIED), 0.05)
    rows = np.clip((found[:, 1] / 0.05).astype(int), 0, grid.values.shape[0] - 1)
    columns = np.clip((found[:, 0] / 0.05).astype(int), 0, grid.values.shape[1] - 1)
    assert to_wall[rows, columns].max() < 0.2


def test_dark_surface_makes_no_free_space_behind_it() -> None:
    grid = ScanGrid(0.1, 20.0)
    wall = Rays(np.zeros((2, 2)), np.array([-0.3, 0.3]), np.array([8.0, 8.0]), 10.0)
    dark = Rays(np.zeros((1, 2)), np.zeros(1), np.array([np.inf]), 10.0)
    grid.add((0.0, 0.0, 0.0), wall)
    grid.add((0.0, 0.0, 0.0), dark)

    drawn = grid.grid()

    def value(x: float, y: float) -> int:
        column, row = np.floor(drawn.frame.cells(x, y)).astype(int)
        return int(drawn.values[row, column])

    assert value(3.0, 0.0) == FREE
    assert [value(x, 0.0) for x in (4.0, 6.0, 8.0)] == [UNKNOWN] * 3


def test_passing_people_leave_no_trace() -> None:
    grid = corridor()
    posed = drive(grid, 1)
    with_person = room(
        ((0.0, 0.0, LENGTH, 1.0), (0.0, 3.0, LENGTH, 4.0), (7.0, 2.2, 7.3, 2.5)), LENGTH, 4.0
    )
    posed[10:14] = drive(with_person, 1)[10:14]

    drawn = build_grid(posed, 0.05, (0.0, 0.0, 0.0), 15.0)

    top, left = drawn.frame.cell(6.8, 2.0)
    bottom, right = drawn.frame.cell(7.5, 2.7)
    assert not np.any(drawn.values[top:bottom, left:right] == OCCUPIED)


def test_pose_that_is_far_away_is_refused_before_memory_is_taken() -> None:
    posed = drive(corridor(), 0)
    posed.append(((1e9, 0.0, 0.0), posed[0][1]))

    with pytest.raises(ValueError, match=r"cover 1e\+09 x .* m, which are .* cells of 0.05 m"):
        build_grid(posed, 0.05, (0.0, 0.0, 0.0), 15.0)


def rays_of_scan(scan: LaserScan) -> Rays:
    return rays_of(scan, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_removed_scans_leave_the_map_without_them() -> None:
    posed = drive(corridor(), 2)
    expected, grid = ScanGrid(0.05, 15.0), ScanGrid(0.05, 15.0)
    for pose, scan in posed[::2]:
        expected.add(pose, rays_of_scan(scan))

    for pose, scan in posed:
        grid.add(pose, rays_of_scan(scan))
    for pose, scan in posed[1::2]:
        grid.remove(pose, rays_of_scan(scan))

    assert np.array_equal(grid.grid().values, expected.grid().values)
    assert grid.grid().frame == expected.grid().frame
    assert grid.on_obstacles() == pytest.approx(expected.on_obstacles())


def test_changes_bring_a_copy_of_the_map_up_to_date() -> None:
    posed = drive(corridor(), 3)
    grid = ScanGrid(0.05, 15.0)
    for pose, scan in posed:
        grid.add(pose, rays_of_scan(scan))
    grid.take_changes()
    copy, frame = grid.whole().values.copy(), grid.frame
    pose, scan = posed[5]

    grid.remove(pose, rays_of_scan(scan))
    grid.add((pose[0] + 0.1, pose[1], pose[2]), rays_of_scan(scan))
    changes = grid.take_changes()

    assert changes is not None
    assert grid.frame == frame
    row, column, cells = changes
    assert not np.array_equal(copy, grid.whole().values)
    copy[row : row + cells.shape[0], column : column + cells.shape[1]] = cells
    assert np.array_equal(copy, grid.whole().values)
    assert grid.take_changes() is None


def test_fewer_points_lie_on_the_walls_of_a_blurred_map() -> None:
    posed = drive(corridor(), 4)
    random = np.random.default_rng(5)
    sharp, blurred = ScanGrid(0.05, 15.0), ScanGrid(0.05, 15.0)

    for pose, scan in posed:
        sharp.add(pose, rays_of_scan(scan))
        x, y = random.normal(0.0, 0.1, 2)
        blurred.add((pose[0] + x, pose[1] + y, pose[2]), rays_of_scan(scan))

    assert blurred.on_obstacles() < 0.8 * sharp.on_obstacles()
    assert sharp.on_obstacles() <= 1.0
    assert ScanGrid(0.05, 15.0).on_obstacles() == 0.0


def test_points_in_free_space_are_told_from_walls() -> None:
    grid = ScanGrid(0.05, 15.0)
    for pose, scan in drive(corridor(), 6):
        grid.add(pose, rays_of_scan(scan))
    along = np.linspace(4.0, 10.0, 50)

    free = np.column_stack((along, np.full(50, 2.0)))
    wall = np.column_stack((along, np.full(50, 3.0)))
    unknown = np.column_stack((along, np.full(50, 9.0)))

    evidence = grid.evidence(3)
    shares = []
    for points in (free, wall, unknown):
        rows, columns = np.array([evidence.frame.cell(x, y) for x, y in points.tolist()]).T
        inside = (rows < evidence.values.shape[0]) & (columns < evidence.values.shape[1])
        values = evidence.values[rows[inside], columns[inside]]
        shares.append(np.mean(values == SEEN_FREE) if values.size else 0.0)
    assert shares[0] == 1.0
    assert shares[1] < 0.1
    assert shares[2] == 0.0
    assert grid.ended_share(wall).mean() > 0.5
    assert grid.ended_share(free).max() < 0.1
