"""The pose tracker joins poses, odometry and scans by their times."""

import numpy as np
import pytest

from cairn.planar.odometry import OdometryChange
from cairn.planar.pose_tracker import EXACT_S, PoseTracker
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from tests.wording import assert_words

SECOND = 1_000_000_000


def driven(tracker: PoseTracker, seconds: float = 2.0, speed: float = 0.5) -> PoseTracker:
    """Add odometry at 10 Hz of a robot that drives straight ahead from time 10 s on."""
    for tenth in range(round(10 * seconds) + 1):
        stamp = 10 * SECOND + tenth * SECOND // 10
        tracker.add_odometry(stamp, (speed * tenth / 10, 0.0, 0.0), speed, 0.0)
    return tracker


def test_pose_is_moved_by_odometry_forward_and_backward_in_time() -> None:
    tracker = driven(PoseTracker())
    tracker.set_pose(11 * SECOND, (3.0, 4.0, np.pi / 2))
    assert tracker.pose_at(12 * SECOND) == pytest.approx((3.0, 4.5, np.pi / 2))
    assert tracker.pose_at(10_500_000_000) == pytest.approx((3.0, 3.75, np.pi / 2))


def test_pose_is_unknown_before_the_first_and_where_odometry_does_not_reach() -> None:
    tracker = driven(PoseTracker())
    assert tracker.pose_at(11 * SECOND) is None
    tracker.set_pose(5 * SECOND, (3.0, 4.0, 0.0))
    assert tracker.pose_at(11 * SECOND) is None
    assert tracker.last_pose == (3.0, 4.0, 0.0)


def test_velocity_extrapolates_odometry_for_a_limited_time() -> None:
    standing, moving = driven(PoseTracker()), driven(PoseTracker(extrapolation_s=0.1))
    assert standing.odometry_at(13 * SECOND) == pytest.approx((1.0, 0.0, 0.0))
    assert moving.odometry_at(12_050_000_000) == pytest.approx((1.025, 0.0, 0.0))
    assert moving.odometry_at(13 * SECOND) == pytest.approx((1.05, 0.0, 0.0))


def test_jump_forgets_the_pose_until_a_newer_one_arrives() -> None:
    tracker = driven(PoseTracker())
    tracker.set_pose(12 * SECOND, (3.0, 4.0, 0.0))
    assert tracker.add_odometry(12_100_000_000, (5.0, 0.0, 0.0)) is OdometryChange.JUMPED
    assert tracker.change == "jumped by 4.00 m"
    assert tracker.waits_for_pose
    tracker.set_pose(12_050_000_000, (3.0, 4.0, 0.0))
    assert tracker.pose_at(12_100_000_000) is None
    tracker.set_pose(12_100_000_000, (3.0, 4.0, 0.0))
    assert tracker.pose_at(12_100_000_000) == (3.0, 4.0, 0.0)


def test_time_that_is_set_back_forgets_everything() -> None:
    tracker = driven(PoseTracker())
    tracker.set_pose(12 * SECOND, (3.0, 4.0, 0.0))
    assert tracker.add_odometry(5 * SECOND, (1.0, 0.0, 0.0)) is OdometryChange.RESET
    assert_words(tracker.change, "back in time", "7.0 s")
    assert tracker.pose_at(5 * SECOND) is None
    assert tracker.odometry_at(4 * SECOND) is None


def test_late_odometry_completes_the_past_and_leaves_the_present() -> None:
    tracker = driven(PoseTracker())
    change = tracker.add_odometry(11_950_000_000, (1.0, 0.0, 0.0), 7.0)
    assert change is OdometryChange.LATE
    assert tracker.odometry_at(11_950_000_000) == pytest.approx((1.0, 0.0, 0.0))
    assert tracker.odometry_at(12 * SECOND) == pytest.approx((1.0, 0.0, 0.0))
    assert tracker.speed == 0.5


def test_late_odometry_that_contradicts_its_neighbors_is_ignored() -> None:
    tracker = driven(PoseTracker())
    change = tracker.add_odometry(11_950_000_000, (9.0, 9.0, 0.0), 7.0)
    assert change is OdometryChange.OUTDATED
    assert tracker.speed == 0.5


def test_odometry_is_late_when_extrapolation_is_no_longer_exact() -> None:
    tracker = PoseTracker()
    assert tracker.late_s(12 * SECOND) == 0.0
    driven(tracker)
    assert tracker.late_s(12 * SECOND + SECOND // 20) == 0.0
    assert tracker.late_s(12 * SECOND + SECOND // 4) == pytest.approx(0.25 - EXACT_S)


def test_sweep_of_a_scan_has_the_motion_from_first_to_last_beam() -> None:
    tracker = driven(PoseTracker())
    ranges = np.ones(101, np.float32)
    scan = LaserScan(
        header=Header(stamp=Time(sec=11)), time_increment=0.002, range_max=9.0, ranges=ranges
    )
    sweep = tracker.sweep(scan)
    assert sweep is not None
    assert sweep.end_ns == pytest.approx(11_200_000_000, abs=1000)
    assert sweep.motion == pytest.approx((0.1, 0.0, 0.0), abs=1e-6)
    early = LaserScan(header=Header(stamp=Time(sec=9)), range_max=9.0, ranges=ranges)
    assert tracker.sweep(early) is None
