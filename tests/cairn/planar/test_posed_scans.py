"""Scans joined with their poses: the motion during the sweep, from odometry in any order."""

import logging

import numpy as np
import pytest

from cairn import SECOND, from_ns
from cairn.planar.messages import with_covariance
from cairn.planar.posed_scans import PosedScans
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.geometry_msgs import Point, PoseWithCovariance
from cairn.schemas.geometry_msgs import Pose as Pose3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

BEGIN = 100 * SECOND
PERIOD = SECOND // 50
NOWHERE: Pose = (0.0, 0.0, 0.0)


def posed_scan_after(odometry: list[tuple[int, Pose]]) -> Pose:
    """Return the pose at the end of a sweep of 0.2 s that begins at `BEGIN` at (2, 0, 0)."""
    scans = PosedScans(NOWHERE, 10.0, 0.6, 0.5)
    for stamp, (x, y, _) in odometry:
        moved = PoseWithCovariance(pose=Pose3(position=Point(x=x, y=y)))
        message = Odometry(header=Header(stamp=from_ns(stamp)), pose=moved)
        scans.add_odometry(message, "odom", logging.getLogger("test"))
    header = Header(stamp=from_ns(BEGIN))
    ranges = np.ones(101, np.float32)
    scans.add_scan(LaserScan(header=header, time_increment=0.002, range_max=9.0, ranges=ranges))
    known = with_covariance((2.0, 0.0, 0.0), np.zeros((3, 3)))
    ready = scans.ready(LocalizationEstimate(header=header, located=True, health=1.0, pose=known))
    assert ready is not None
    return ready.pose


def test_order_in_which_odometry_arrives_does_not_change_the_motion_of_a_sweep() -> None:
    # It stands for half of the sweep, then drives.
    drive = [(BEGIN + k * PERIOD, (0.01 * max(0, k - 5), 0.0, 0.0)) for k in range(12)]
    late = [drive[k] for k in (0, 11, 4, 7, 2, 10, 1, 9, 3, 5, 8, 6)]

    assert posed_scan_after(late) == pytest.approx(posed_scan_after(drive))
    assert posed_scan_after(late)[0] == pytest.approx(2.05)


def test_sweep_across_a_jump_of_odometry_has_no_motion() -> None:
    drive = [(BEGIN + k * PERIOD, (0.0 if k < 6 else 5.0, 0.0, 0.0)) for k in range(12)]

    assert posed_scan_after(drive) == pytest.approx((2.0, 0.0, 0.0))
