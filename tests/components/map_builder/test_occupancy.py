"""Tests of grid map updates: moved obstacles vanish and appear, people leave no trace."""

import math
import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.components.map_builder.occupancy import Occupancy
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid, OccupancyCells
from cairn.planar.poses import Pose
from cairn.planar.scan_grid import build_grid
from cairn.planar.scans import Rays
from cairn.schemas.sensor_msgs import LaserScan
from tests.components.localizer.room import RESOLUTION, ROOM, Box, room, scanned

pytestmark = pytest.mark.slow


OLD: Box = (4.0, 3.0, 5.5, 3.6)
NEW: Box = (4.0, 5.5, 5.5, 6.1)


def rays(points: NDArray[np.float64]) -> Rays:
    return Rays(
        np.zeros((len(points), 2)),
        np.arctan2(points[:, 1], points[:, 0]),
        np.hypot(points[:, 0], points[:, 1]),
        10.0,
    )


def pass_by(
    occupancy: Occupancy,
    world: OccupancyCells,
    began_s: float,
    error_m: float = 0.02,
    seed: int = 0,
) -> float:
    """Drive the robot once around the middle of the room; return the final time."""
    random = np.random.default_rng(seed)
    for k in range(100):
        around = 2 * math.pi * k / 100
        pose: Pose = (4.7 + 2.2 * math.cos(around), 4.2 + 2.0 * math.sin(around), around + 2.4)
        seen = scanned(world, pose, random)
        believed = (
            pose[0] + random.normal(0, error_m),
            pose[1] + random.normal(0, error_m),
            pose[2] + random.normal(0, error_m / 4),
        )
        occupancy.integrate(began_s + 0.2 * k, believed, rays(seen))
    return began_s + 20.0


def share_occupied(occupancy: Occupancy, box: Box) -> float:
    left, bottom, right, top = (round(edge / RESOLUTION) for edge in box)
    return float((occupancy.cells[bottom:top, left:right] == OCCUPIED).mean())


def test_moved_furniture_vanishes_and_appears_at_its_new_position() -> None:
    occupancy = Occupancy(room(), 8.0, 60.0)
    world = room((*(box for box in ROOM if box != OLD), NEW))
    now = 0.0

    for seed in range(3):
        now = pass_by(occupancy, world, now, seed=seed)

    left, bottom, right, _ = NEW
    assert share_occupied(occupancy, OLD) < 0.02
    assert share_occupied(occupancy, (left, bottom - 0.05, right, bottom + 0.1)) > 0.3


def test_unchanged_room_stays_unchanged() -> None:
    occupancy = Occupancy(room(), 8.0, 60.0)
    now = 0.0

    for seed in range(5):
        now = pass_by(occupancy, room(), now, seed=seed)

    changed = occupancy.cells != room().values
    assert changed.mean() < 0.001


def test_passing_people_leave_no_trace_and_a_person_that_stayed_is_removed() -> None:
    occupancy = Occupancy(room(), 8.0, 60.0)
    pose = (2.0, 2.0, 0.0)
    random = np.random.default_rng(0)
    for k in range(60):
        walker = (3.0, 1.0 + 0.1 * k % 3, 3.4, 1.4 + 0.1 * k % 3)
        occupancy.integrate(
            0.2 * k, pose, rays(scanned(room((*ROOM, walker)), pose, random, reach=10.0))
        )
    assert np.array_equal(occupancy.cells, room().values)

    stander = (3.0, 1.8, 3.4, 2.2)
    for k in range(60, 120):
        occupancy.integrate(
            0.2 * k, pose, rays(scanned(room((*ROOM, stander)), pose, random, reach=10.0))
        )
    assert share_occupied(occupancy, (2.95, 1.8, 3.1, 2.2)) > 0.15

    for k in range(120, 180):
        occupancy.integrate(0.2 * k, pose, rays(scanned(room(), pose, random, reach=10.0)))
    assert share_occupied(occupancy, (2.9, 1.7, 3.5, 2.3)) == 0.0


def seen_through(occupancy: Occupancy, began_s: float, scans: int, far_m: float = 2.0) -> None:
    """Let rays of a robot at (5, 10) pass through a cell `far_m` [m] ahead of it."""
    around = np.linspace(-math.pi, math.pi, 481, endpoint=False)
    through = Rays(np.zeros((481, 2)), around, np.full(481, far_m + 1.5), 10.0)
    for k in range(scans):
        occupancy.integrate(began_s + 0.2 * k, (5.01, 10.01, 0.0), through)


def a_post(far_m: float = 2.0) -> tuple[Occupancy, tuple[int, int]]:
    cells = np.zeros((400, 400), np.int8)
    row, column = 200, 100 + round(far_m / RESOLUTION)
    cells[row, column] = OCCUPIED
    return Occupancy(Grid(cells, Frame(RESOLUTION)), 8.0, 60.0), (row, column)


@pytest.mark.parametrize("far_m", [0.5, 1.0, 2.0, 4.0])
def test_obstacle_that_rays_pass_for_four_seconds_is_removed(far_m: float) -> None:
    occupancy, post = a_post(far_m)

    seen_through(occupancy, 0.0, 15, far_m)
    assert occupancy.cells[post] == OCCUPIED

    seen_through(occupancy, 3.0, 7, far_m)
    assert occupancy.cells[post] == FREE


@pytest.mark.parametrize("far_m", [2.0, 3.0, 4.0, 6.0])
def test_mapped_glass_that_returns_one_ray_in_ten_stays(
    far_m: float,
) -> None:
    random = np.random.default_rng(0)
    cells = np.zeros((400, 400), np.int8)
    pane = 100 + round(far_m / RESOLUTION)
    cells[:, pane] = OCCUPIED
    occupancy = Occupancy(Grid(cells, Frame(RESOLUTION)), 8.0, 60.0)
    angles = np.radians(np.arange(-60.0, 60.0, 0.75))

    for k in range(150):
        returned = random.random(angles.size) < 0.1
        ranges = np.where(returned, far_m + 0.025, far_m + 3.025) / np.cos(angles)
        ranges += random.normal(0.0, 0.015, angles.size)
        ranges[ranges > 10.0] = math.inf
        seen = Rays(np.zeros((angles.size, 2)), angles, ranges, 10.0)
        occupancy.integrate(0.2 * k, (5.0, 10.01, 0.0), seen)

    assert (occupancy.cells[180:220, pane] == OCCUPIED).mean() > 0.75


def test_returned_window_contains_the_changes_only() -> None:
    grid = Grid(np.zeros((20, 40), np.int8), Frame(0.1))
    occupancy = Occupancy(grid, 0.0, 60.0)
    wall = rays(np.array([[1.0, 0.0]]))

    printed = [occupancy.integrate(0.2 * k, (1.05, 1.05, 0.0), wall) for k in range(20)]

    windows = [window for window in printed if window is not None]
    assert len(windows) == 1
    assert (windows[0].row, windows[0].column) == (10, 20)
    assert windows[0].values.tolist() == [[OCCUPIED]]


def test_rays_outside_the_map_or_without_return_change_nothing() -> None:
    occupancy = Occupancy(Grid(np.full((10, 10), UNKNOWN, np.int8), Frame(0.1)), 0.0, 60.0)
    far = Rays(
        np.zeros((3, 2)), np.array([0.0, 2.0, 4.0]), np.array([50.0, math.inf, math.nan]), 80.0
    )

    for k in range(5):
        occupancy.integrate(float(k), (0.55, 0.55, 0.0), far)
    occupancy.integrate(6.0, (-30.0, 4.0, 0.0), far)

    assert occupancy.cells[5, 5:].tolist() == [FREE] * 5
    assert occupancy.cells[0, 0] == UNKNOWN


def test_map_is_built_from_scans_with_poses() -> None:
    random = np.random.default_rng(0)

    def scan_from(pose: Pose) -> LaserScan:
        seen = scanned(room(), pose, random, field_of_view=math.radians(350), beams=700, reach=8.0)
        angle = np.arctan2(seen[:, 1], seen[:, 0])
        ranges = np.full(701, np.inf, np.float32)
        index = np.rint((angle + math.pi) / (2 * math.pi) * 700).astype(int)
        ranges[index] = np.hypot(seen[:, 0], seen[:, 1])
        return LaserScan(
            angle_min=-math.pi,
            angle_max=math.pi,
            angle_increment=2 * math.pi / 700,
            range_min=0.1,
            range_max=8.0,
            ranges=ranges,
        )

    poses = [(2.0, 2.0, 0.3), (3.0, 5.0, 1.0), (6.5, 5.0, -2.0), (6.5, 2.0, 0.0)]

    drawn = build_grid(((p, scan_from(p)) for p in poses), 0.1, (0.0, 0.0, 0.0), 8.0)

    for x, y, value in ((3.0, 2.0, FREE), (6.0, 5.5, FREE), (4.75, 3.62, OCCUPIED)):
        row, column = drawn.frame.cell(x, y)
        assert (drawn.values[row - 1 : row + 2, column - 1 : column + 2] == value).any()
    row, column = drawn.frame.cell(4.75, 3.3)
    assert drawn.values[row, column] == UNKNOWN


def test_changes_of_a_lost_robot_are_undone() -> None:
    occupancy = Occupancy(room(), 8.0, 60.0)
    now = pass_by(occupancy, room((*(box for box in ROOM if box != OLD), NEW)), 0.0)
    found = occupancy.cells.copy()
    lost_at = now
    random = np.random.default_rng(3)
    for k in range(100):
        seen = scanned(room(), (2.0, 2.0, 0.1 * k), random)
        occupancy.integrate(now + 0.2 * k, (6.0, 5.0, 0.1 * k), rays(seen))
    assert not np.array_equal(occupancy.cells, found)

    window = occupancy.undo(lost_at)

    assert window is not None
    assert np.array_equal(occupancy.cells, found)
    assert occupancy.undo(lost_at) is None


def drive_into_the_unknown(
    occupancy: Occupancy, scans: int, began_s: float = 0.0
) -> list[NDArray[np.int8]]:
    """Drive with scans that change much; return the map before each of them."""
    random = np.random.default_rng(0)
    angles = np.linspace(-2.35, 2.35, 541)
    before = []
    for k in range(scans):
        before.append(occupancy.cells.copy())
        seen = Rays(np.zeros((541, 2)), angles, random.uniform(2.0, 25.0, 541), 30.0)
        pose = (10.0 + 0.1 * k, 20.0 + k % 7, 0.3 * k)
        occupancy.integrate(began_s + 0.2 * k, pose, seen)
    return before


def unknown_map(undo_s: float) -> Occupancy:
    return Occupancy(Grid(np.full((800, 800), UNKNOWN, np.int8), Frame(RESOLUTION)), 1.0, undo_s)


def test_undo_restores_any_recorded_time_exactly() -> None:
    occupancy = unknown_map(undo_s=20.0)
    before = drive_into_the_unknown(occupancy, 200)

    for scan in (199, 170, 101):
        occupancy.undo(0.2 * scan - 0.1)
        assert np.array_equal(occupancy.cells, before[scan])

    assert occupancy.undo(0.0) is not None
    oldest = next(k for k in range(200) if np.array_equal(before[k], occupancy.cells))
    assert oldest == pytest.approx(99, abs=1)


@pytest.mark.accuracy
def test_undo_needs_little_memory() -> None:
    occupancy = unknown_map(undo_s=60.0)
    tracemalloc.start()
    try:
        began, _ = tracemalloc.get_traced_memory()
        for drive in range(3):
            drive_into_the_unknown(occupancy, 40, 20.0 * drive)
            grown, _ = tracemalloc.get_traced_memory()
            assert grown - began < 6 * occupancy.cells.nbytes
    finally:
        tracemalloc.stop()


def test_undo_drops_undecided_evidence() -> None:
    occupancy, post = a_post()
    seen_through(occupancy, 0.0, 15)

    assert occupancy.undo(0.0) is None
    seen_through(occupancy, 3.0, 15)

    assert occupancy.cells[post] == OCCUPIED
