"""The scan memory: which obstacles it keeps, and which it forgets."""

import math

import numpy as np
import pytest

from cairn.components.motion_control.scan_memory import ScanMemory
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays, rays_of
from cairn.schemas.sensor_msgs import LaserScan
from tests.components.motion_control.world import rays_from

SECOND = 1_000_000_000
ANGLES = np.radians(np.arange(-135.0, 136.0))


def rays(ranges: np.ndarray, at: Pose = (0, 0, 0)) -> Rays:
    return rays_from(at, ANGLES, ranges)


def one_hit(bearing: float, distance: float) -> np.ndarray:
    ranges = np.full(ANGLES.size, np.inf)
    ranges[round(math.degrees(bearing)) + 135] = distance
    return ranges


def test_obstacle_outside_the_view_counts_for_a_while() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), rays(one_hit(0.0, 1.0)))
    turned = (0.0, 0.0, math.pi)

    space.add(2 * SECOND, turned, rays(one_hit(0.0, 2.0), turned))
    near = space.around(turned, 3.0)
    seen = sorted(near.points.round(6).tolist())
    space.add(4 * SECOND, turned, rays(one_hit(0.0, 2.0), turned))
    later = space.around(turned, 3.0)

    assert seen == [[-1.0, 0.0], [2.0, 0.0]]
    assert near.nearest == 1.0
    assert later.points.round(6).tolist() == [[2.0, 0.0]]


def test_beam_removes_points_that_it_passes_through() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), rays(one_hit(0.5, 1.0)))

    space.add(SECOND // 10, (0, 0, 0), rays(np.full(ANGLES.size, np.inf)))

    assert len(space.around((0, 0, 0), 3.0).points) == 0


def test_beam_without_a_measurement_removes_nothing() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), rays(one_hit(0.5, 1.0)))

    space.add(SECOND // 10, (0, 0, 0), rays(np.full(ANGLES.size, np.nan)))

    assert len(space.around((0, 0, 0), 3.0).points) == 1


def test_hidden_points_are_kept() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), rays(one_hit(0.0, 2.0)))

    space.add(SECOND // 10, (0, 0, 0), rays(one_hit(0.0, 1.0)))

    assert sorted(space.around((0, 0, 0), 3.0).points[:, 0].round(6).tolist()) == [1.0, 2.0]


def test_turning_robot_sees_points_at_their_positions() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    ended = (0.0, 0.0, 0.2)

    def turning(ranges: np.ndarray) -> Rays:
        scan = LaserScan(
            angle_min=float(ANGLES[0]),
            angle_max=float(ANGLES[-1]),
            angle_increment=math.radians(1),
            time_increment=1e-4,
            range_max=10.0,
            ranges=ranges.astype(np.float32),
        )
        return rays_of(scan, (0, 0, 0), ended).placed(ended)

    # The beam straight ahead is measured halfway between the two headings.
    space.add(0, (0, 0, 0), turning(one_hit(0.0, 2.0)))
    (there,) = space.around((0, 0, 0), 3.0).points.tolist()
    space.add(SECOND // 10, (0, 0, 0), turning(one_hit(0.0, 3.0)))
    (beyond,) = space.around((0, 0, 0), 4.0).points.tolist()

    assert there == pytest.approx((2 * math.cos(0.1), 2 * math.sin(0.1)), abs=1e-5)
    assert beyond == pytest.approx((3 * math.cos(0.1), 3 * math.sin(0.1)), abs=1e-5)


def test_ground_counts_as_seen_for_a_limited_time() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    space.add(SECOND, (0, 0, 0), rays(np.full(ANGLES.size, np.inf)))

    assert space.is_ground_seen((0, 0, 0), 0.0, 0.5, 0)
    assert space.is_ground_seen((0, 0, 0), math.pi / 2, 0.5, 0)
    assert not space.is_ground_seen((0, 0, 0), math.pi, 0.5, 0)
    assert not space.is_ground_seen((0, 0, 0), 0.0, 0.5, 2 * SECOND)


def test_distant_ground_in_the_same_slot_does_not_count_as_seen() -> None:
    space = ScanMemory(30 * SECOND, 0.22)
    space.add(SECOND, (0, 0, 0), rays(np.full(ANGLES.size, np.inf)))

    assert not any(
        space.is_ground_seen((0.1 * x, 0.1 * y, 0), 0.0, 0.5, SECOND)
        for x in range(-160, 161, 8)
        for y in range(-160, 161, 8)
        if max(abs(x), abs(y)) > 30
    )


@pytest.mark.parametrize("radius", [0.1, 0.5, 1.0])
def test_robots_of_all_sizes_see_the_ground_ahead_in_open_space(radius: float) -> None:
    space = ScanMemory(3 * SECOND, radius)
    space.add(SECOND, (0, 0, 0), rays(np.full(ANGLES.size, np.inf)))

    assert space.around((0, 0, 0), 3.3, 0.6, 0.6).ground_seen_ahead
    assert not space.around((0, 0, math.pi), 3.3, 0.6, 0.6).ground_seen_ahead


def test_beams_on_both_sides_of_the_seam_of_a_full_turn_remove_points() -> None:
    around = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    for shift in np.linspace(-1.0, 1.0, 9):
        space = ScanMemory(3 * SECOND, 0.22)
        space.add(0, (0, 0, 0), rays_from((0, 0, 0), np.array([math.pi + math.radians(shift)]),
                                          np.array([1.0])))  # fmt: skip

        space.add(SECOND // 10, (0, 0, 0), rays_from((0, 0, 0), around, np.full(360, np.inf)))

        assert len(space.around((0, 0, 0), 3.0).points) == 0, shift


def test_scans_of_any_size_are_accepted() -> None:
    space = ScanMemory(3 * SECOND, 0.22)

    space.add(0, (0, 0, 0), rays_from((0, 0, 0), np.empty(0), np.empty(0)))
    space.add(1, (0, 0, 0), rays_from((0, 0, 0), np.array([1.0]), np.array([1.0])))
    around = np.linspace(-math.pi, math.pi, 7200, endpoint=False)
    for k in range(30):
        many = np.full(7200, 1.0 + 0.02 * k)
        space.add(2 + k, (0, 0, 0), rays_from((0, 0, 0), around, many))

    points = space.around((0, 0, 0), 3.0).points
    assert len(points) <= 8192
    assert np.isfinite(points).all()


def test_predicted_positions_count_where_the_robot_may_meet_them() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), rays(np.full(ANGLES.size, np.inf)))
    space.set_predictions(np.array([[1.0, 0.0, 0.4], [2.5, 0.0, 0.4], [0.1, 0.0, 1.4]]))

    around = space.around((0, 0, 0), 3.0, speed=0.6, fastest=0.6)

    assert around.points.tolist() == [[1.0, 0.0]]
    assert around.nearest == 3.0


def test_near_point_is_removed_only_by_beams_from_two_directions() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    nothing = np.full(ANGLES.size, np.inf)
    space.add(0, (0, 0, 0), rays(one_hit(0.0, 0.3)))

    for k in range(1, 6):  # like beams along a thin wall, or past its end
        space.add(k * SECOND // 10, (0, 0, 0), rays(nothing))
    along = space.around((0, 0, 0), 3.0).points.copy()
    aside = (0.0, 0.1, 0.0)
    space.add(SECOND, aside, rays(nothing, aside))

    assert along.round(6).tolist() == [[0.3, 0.0]]
    assert len(space.around(aside, 3.0).points) == 0


def test_near_point_that_is_hit_again_is_replaced() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    space.add(0, (0, 0, 0), rays(one_hit(0.0, 0.3)))

    space.add(SECOND // 10, (0, 0, 0), rays(one_hit(0.0, 0.34)))

    assert space.around((0, 0, 0), 3.0).points.round(6).tolist() == [[0.34, 0.0]]


def test_ground_whose_obstacles_are_forgotten_does_not_count_as_seen() -> None:
    space = ScanMemory(3 * SECOND, 0.22)
    away = (0.0, 0.0, math.pi)
    space.add(0, (0, 0, 0), rays(np.full(ANGLES.size, np.inf)))
    assert space.is_ground_seen((0, 0, 0), 0.0, 0.3, 0)

    space.add(round(3.5 * SECOND), away, rays(np.full(ANGLES.size, np.inf), away))

    assert not space.is_ground_seen((0, 0, 0), 0.0, 0.3, 0)
