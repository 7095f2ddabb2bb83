"""A scanner's yaw on the robot is estimated from its motion, or found to be undetermined."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn.components.simulation.ray_casting import cast
from cairn.planar.mount_estimation import estimate_mount_yaw, seems_upside_down
from cairn.planar.poses import Pose, compose
from cairn.schemas.sensor_msgs import LaserScan
from tests.components.replay_devices.wild_logs import Drive, office_drive
from tests.sweeps import sampled

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
BEARINGS = np.radians(np.arange(180) - 90.0)


def scan_of(ranges: Array) -> LaserScan:
    return LaserScan(
        angle_min=float(BEARINGS[0]),
        angle_max=float(BEARINGS[-1]),
        angle_increment=math.radians(1.0),
        range_min=0.02,
        range_max=50.0,
        ranges=ranges.astype(np.float32),
    )


def recorded(drive: Drive) -> tuple[list[LaserScan], Array]:
    return [scan_of(ranges) for ranges in drive.scans.values()], drive.odometry[list(drive.scans)]


def along(poses: list[Pose], segments: Array) -> tuple[list[LaserScan], Array]:
    random = np.random.default_rng(3)
    scans = []
    for x, y, theta in poses:
        starts = np.tile([x, y], (len(BEARINGS), 1))
        ranges, _ = cast(starts, BEARINGS + theta, segments, np.zeros((0, 3)), 40.0)
        scans.append(scan_of(ranges + random.normal(0.0, 0.01, len(BEARINGS))))
    return scans, np.array(poses)


@pytest.mark.parametrize("yaw", sampled([-2.0, 0.0, 0.1, math.pi / 2, 3.1]))
def test_yaw_of_a_scanner_is_found_in_an_office(yaw: float) -> None:
    found = estimate_mount_yaw(*recorded(office_drive((0.2, 0.1, yaw))))

    assert found is not None
    assert found.yaw == pytest.approx(yaw, abs=0.015)
    assert abs(found.yaw - yaw) < 3 * found.deviation
    assert found.deviation < 0.03


@pytest.mark.accuracy
def test_driving_backwards_does_not_turn_the_scanner() -> None:
    scans, poses = recorded(office_drive((0.2, 0.1, 0.5)))

    found = estimate_mount_yaw(scans[::-1], poses[::-1])

    assert found is not None
    assert found.yaw == pytest.approx(0.5, abs=0.02)


def test_corridor_without_ends_does_not_determine_the_yaw() -> None:
    walls = np.array([[-500.0, -1.0, 500.0, -1.0], [-500.0, 1.2, 500.0, 1.2]])
    poses: list[Pose] = [(0.1 * k, 0.0, 0.0) for k in range(200)]

    assert estimate_mount_yaw(*along(poses, walls)) is None


def test_robot_that_stands_or_turns_does_not_determine_the_yaw() -> None:
    room = np.array([[-4.0, -3.0, 4.0, -3.0], [4.0, -3.0, 4.0, 3.0], [-4.0, 3.0, 4.0, 3.0]])
    standing: list[Pose] = [(0.0, 0.0, 0.0)] * 100
    arc: list[Pose] = [(0.0, 0.0, 0.0)]
    for _ in range(200):
        arc.append(compose(arc[-1], (0.02, 0.0, 0.02)))

    assert estimate_mount_yaw(*along(standing, room)) is None
    assert estimate_mount_yaw(*along(arc, room)) is None


@pytest.mark.parametrize("yaw", sampled([-2.0, 0.0]))
def test_scanner_upside_down_is_noticed_where_the_robot_turns(yaw: float) -> None:
    room = np.array([[-4.0, -3.0, 4.0, -3.0], [4.0, -3.0, 4.0, 3.0], [-4.0, 3.0, 4.0, 3.0],
                     [-4.0, -3.0, -4.0, 3.0], [-4.0, 1.0, -2.0, 1.0]])  # fmt: skip
    turning: list[Pose] = [(0.5, 0.3, 0.1 * k) for k in range(100)]
    scans, poses = along([compose(pose, (0.0, 0.0, yaw)) for pose in turning], room)
    mirrored = [scan_of(scan.ranges[::-1].astype(np.float64)) for scan in scans]

    assert not seems_upside_down(scans, poses)
    assert seems_upside_down(mirrored, poses)
    assert not seems_upside_down(mirrored[:10], poses[:10])


def test_too_few_scans_do_not_determine_the_yaw() -> None:
    scans, poses = recorded(office_drive((0.2, 0.1, 0.5)))

    assert estimate_mount_yaw([], np.zeros((0, 3))) is None
    assert estimate_mount_yaw(scans[10:20], poses[10:20]) is None


def test_scanner_that_measures_nothing_does_not_determine_the_yaw() -> None:
    _, poses = recorded(office_drive((0.2, 0.1, 0.5)))
    blind = [scan_of(np.full(180, math.inf))] * len(poses)

    assert estimate_mount_yaw(blind, poses) is None
