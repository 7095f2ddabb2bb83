"""The obstacle memory: which points it keeps, and which it forgets."""

import math

import numpy as np
import pytest

from cairn.planar.obstacle_memory import Clearing, ObstacleMemory, points_near, ranges_behind
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays

HERE: Pose = (0.0, 0.0, 0.0)


def rays(angles: np.ndarray, ranges: float) -> Rays:
    return Rays(np.zeros((angles.size, 2)), angles, np.full(angles.size, ranges), 10.0)


@pytest.mark.parametrize("clearing", [Clearing(-0.1, width=0.06), Clearing(-0.1)])
@pytest.mark.parametrize(
    ("ranges", "left"), [(1.5, 0), (math.inf, 0), (0.95, 0), (0.85, 1), (math.nan, 1)]
)
def test_beams_clear_what_they_pass_or_hit_again(
    clearing: Clearing, ranges: float, left: int
) -> None:
    memory = ObstacleMemory(clearing)
    memory.add(0, np.array([[1.0, 0.0]]))

    memory.clear(HERE, rays(np.radians(np.arange(-90.0, 91.0)), ranges), 0)

    assert len(memory.points) == left


def test_points_that_are_old_or_far_are_forgotten() -> None:
    memory = ObstacleMemory(Clearing(-0.1), 2.0)
    for stamp, x in ((0, 1.0), (1, 1.1), (2, 3.0)):
        memory.add(stamp, np.array([[x, 0.0]]))

    memory.clear(HERE, rays(np.empty(0), 0.0), 1)

    assert memory.points.tolist() == [[1.1, 0.0]]
    memory.forget_before(2)
    assert len(memory.points) == 0


def test_points_that_are_seen_again_count_from_then_on() -> None:
    memory = ObstacleMemory(Clearing(-0.1))
    memory.add(5, np.array([[1.0, 0.0], [2.0, 0.0]]))

    memory.see_again(9, np.array([True, False]))
    memory.see_again(3, np.array([False, True]))
    memory.forget_before(6)

    assert memory.points.tolist() == [[1.0, 0.0]]


@pytest.mark.parametrize("count", [360, 1024])
def test_each_direction_of_a_turning_robot_has_its_own_beam(count: int) -> None:
    # A float32, as in messages: a full turn has not exactly `count` steps.
    step = float(np.float32(2.0 * math.pi / count))
    beams = np.arange(count // 2)
    for heading in np.linspace(-math.pi, math.pi, 7):
        angles = heading - 1.5 + step * beams
        points = np.column_stack((np.cos(angles), np.sin(angles)))
        ranges = beams.astype(np.float64) + 2.0

        behind = ranges_behind(points, np.zeros((beams.size, 2)), angles, ranges, 0.0)

        assert behind == pytest.approx(ranges - 1.0)


def test_outermost_beams_may_stand_for_directions_beside_them() -> None:
    scan = rays(np.radians(np.arange(-10.0, 11.0)), 2.0)
    beside = np.radians([12.0, 20.0])
    points = np.column_stack((np.cos(beside), np.sin(beside)))

    behind = [
        ranges_behind(points, scan.starts, scan.angles, scan.ranges, beside).tolist()
        for beside in (0.06, 0.0)
    ]

    assert behind[0] == pytest.approx([1.0, math.nan], nan_ok=True)
    assert behind[1] == pytest.approx([math.nan, math.nan], nan_ok=True)


def test_nearby_points_are_in_the_frame_of_the_robot() -> None:
    points = np.array([[1.0, 2.0], [1.0, 5.0]])

    near = points_near(points, (1.0, 1.0, math.pi / 2), 2.0)

    assert near == pytest.approx(np.array([[1.0, 0.0]]))
