"""Tests of how keyframes keep their scans: in few bytes, and without a loss that matters."""

import math

import numpy as np

from cairn.components.slam.keyframes import scan_surfaces
from cairn.components.slam.point_cloud import PointCloud


def random_cloud(count: int = 500, farthest: float = 30.0) -> PointCloud:
    random = np.random.default_rng(0)
    direction = random.uniform(-math.pi, math.pi, count)
    normals = np.column_stack((np.cos(direction), np.sin(direction)))
    normals[::7] = 0.0
    return PointCloud(random.uniform(-farthest, farthest, (count, 2)), normals)


def test_surfaces_are_kept_in_six_bytes_each_within_half_a_millimeter() -> None:
    cloud = random_cloud()

    kept = scan_surfaces(cloud)

    assert kept.values.nbytes == 6 * cloud.count
    assert np.abs(kept.cloud().points - cloud.points).max() < 5e-4
    assert np.abs(kept.cloud().normals - cloud.normals).max() < 1e-4
    assert np.all(kept.cloud().normals[::7] == 0.0)


def test_surfaces_that_were_kept_before_do_not_change_again() -> None:
    kept = scan_surfaces(random_cloud())
    read = kept.cloud()  # as from a graph file, which has single precision
    points, normals = read.points.astype(np.float32), read.normals.astype(np.float32)

    again = scan_surfaces(PointCloud(points.astype(float), normals.astype(float)))

    assert np.array_equal(again.values, kept.values)


def test_scan_without_points_has_no_surfaces() -> None:
    nothing = scan_surfaces(PointCloud(np.zeros((0, 2)), np.zeros((0, 2))))

    assert nothing.count == nothing.cloud().count == 0
