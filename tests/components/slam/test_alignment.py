"""Alignment: random poses are recovered; directions that no surface shows stay unknown."""

import math

import numpy as np
import pytest

from cairn.components.slam.alignment import Reference
from cairn.components.slam.point_cloud import PointCloud, cloud_of
from cairn.planar.poses import apart, inverse

PRIOR = np.diag([0.3**-2, 0.3**-2, 0.2**-2])


def walls(lines: list[tuple[float, float, float, float, float, float]]) -> PointCloud:
    """Points of walls x1, y1, x2, y2 with the normal of each."""
    share = np.linspace(0.0, 1.0, 100)[:, None]
    points, normals = [], []
    for x1, y1, x2, y2, nx, ny in lines:
        points.append(np.array([x1, y1]) + share * np.array([x2 - x1, y2 - y1]))
        normals.append(np.tile([nx, ny], (100, 1)))
    return PointCloud(np.concatenate(points), np.concatenate(normals).astype(float))


ROOM: list[tuple[float, float, float, float, float, float]] = [
    (0, 0, 6, 0, 0, 1),
    (6, 0, 6, 4, -1, 0),
    (6, 4, 0, 4, 0, -1),
    (0, 4, 0, 0, 1, 0),
]


@pytest.mark.parametrize("seed", range(20))
def test_a_random_pose_is_recovered(seed: int) -> None:
    random = np.random.default_rng(seed)
    pose = (*random.uniform(-0.2, 0.2, 2).tolist(), float(random.uniform(-0.08, 0.08)))
    room = walls(ROOM)
    noisy = PointCloud(room.points + 0.01 * random.standard_normal(room.points.shape), room.normals)
    found = Reference(room).align(noisy.placed(inverse(pose)), (0.0, 0.0, 0.0), PRIOR, 0.4)
    assert not apart(found.pose, pose, 0.01, 0.005)
    assert found.paired > 0.95


def test_a_corridor_shows_nothing_of_the_direction_along_it() -> None:
    corridor = walls([(0, 0, 20, 0, 0, 1), (20, 2, 0, 2, 0, -1)])
    found = Reference(corridor).align(corridor, (0.0, 0.1, 0.0), PRIOR, 0.4)
    assert abs(found.pose[1]) < 0.005
    assert found.information[0, 0] < 1e-6 * found.information[1, 1]


def test_points_farther_off_count_as_less_certain() -> None:
    random = np.random.default_rng(0)
    room = walls(ROOM)
    rough = PointCloud(room.points + 0.05 * random.standard_normal(room.points.shape), room.normals)
    reference, still = Reference(room), (0.0, 0.0, 0.0)
    exact, noisy = (reference.align(cloud, still, PRIOR, 0.2) for cloud in (room, rough))
    assert noisy.information[0, 0] < 0.5 * exact.information[0, 0]


def test_normals_point_from_the_surface_to_the_scanner() -> None:
    angles = np.linspace(-0.6, 0.6, 61)
    points = np.column_stack((np.full(61, 3.0), 3.0 * np.tan(angles)))
    cloud = cloud_of(points, np.arange(61), np.zeros(2), math.radians(1.15))
    assert np.allclose(cloud.normals, [-1.0, 0.0], atol=1e-6)
