"""Scans become rays and points in the robot's frame, for each mounting of the scanner."""

import math

import numpy as np
import pytest

from cairn.planar.poses import Pose, between, compose, relative
from cairn.planar.scans import beams_of, rays_of, sweep_s
from cairn.schemas.sensor_msgs import LaserScan


def scan(
    ranges: list[float], first: float = 0.0, step: float = 0.1, time_increment: float = 0.0
) -> LaserScan:
    return LaserScan(
        angle_min=first,
        angle_max=first + step * (len(ranges) - 1),
        angle_increment=step,
        range_min=0.1,
        range_max=10.0,
        ranges=np.array(ranges, np.float32),
        time_increment=time_increment,
    )


def test_ranges_are_interpreted_as_in_rep_117() -> None:
    beams = beams_of(scan([1.0, 0.05, 10.0, math.inf, -math.inf, math.nan, 12.0]), (0.0, 0.0, 0.0))

    assert beams.ranges[0] == 1.0
    assert np.isnan(beams.ranges[[1, 4, 5]]).all()  # too near, too near, failed
    assert np.isposinf(beams.ranges[[2, 3, 6]]).all()  # nothing hit
    assert beams.hit.tolist() == [True, False, False, False, False, False, False]


def test_mounting_pose_of_the_scanner_is_applied() -> None:
    points = beams_of(scan([2.0]), (0.3, -0.1, math.pi / 2)).points()

    assert points[0] == pytest.approx((0.3, 1.9))


def test_standing_robot_has_the_same_points_with_and_without_sweep_times() -> None:
    taken = scan([1.0, 2.0, 3.0], time_increment=0.01)

    still = rays_of(taken, (0.2, 0.0, 0.1), (0.0, 0.0, 0.0)).points()

    assert still == pytest.approx(beams_of(taken, (0.2, 0.0, 0.1)).points())


def test_each_ray_starts_at_the_pose_of_the_robot_at_its_time() -> None:
    # A wall at x = 3, seen by a robot that drives and turns while it sweeps.
    mount: Pose = (0.2, 0.1, 0.0)
    begin, end = (0.0, 0.0, -0.3), (0.1, 0.05, 0.4)
    count, step = 41, 0.02
    ranges = []
    for k in range(count):
        at = compose(between(begin, end, k / (count - 1)), mount)
        ranges.append((3.0 - at[0]) / math.cos(at[2] - 0.4 + step * k))
    taken = scan(ranges, first=-0.4, step=step, time_increment=0.001)

    points = rays_of(taken, mount, relative(begin, end)).points()

    x = [compose(end, (px, py, 0.0))[0] for px, py in points.tolist()]
    assert x == pytest.approx([3.0] * count, abs=0.005)
    assert sweep_s(taken) == pytest.approx(0.04)


def test_rays_are_transformed_to_the_frame_of_the_base_pose() -> None:
    base, mount = (2.0, -1.0, 2.5), (0.2, 0.1, 0.3)
    rays = rays_of(scan([1.0, 2.0], time_increment=0.1), mount, (0.3, 0.0, 0.4))

    placed = rays.placed(base)

    expected = [compose(base, (x, y, 0.0))[:2] for x, y in rays.points().tolist()]
    assert placed.points() == pytest.approx(np.array(expected))
