"""Tests of scans that wait for odometry."""

import numpy as np
import pytest

from cairn.planar.waiting_scans import WaitingScans
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.system.clock import SECOND


def scan_at(seconds: float) -> LaserScan:
    """A scan whose beams have one time [s]."""
    stamp = round(seconds * SECOND)
    time = Time(sec=stamp // SECOND, nanosec=stamp % SECOND)
    return LaserScan(header=Header(stamp=time), range_max=9.0, ranges=np.ones(9, np.float32))


def test_scan_waits_until_odometry_has_nearly_reached_it() -> None:
    scans, scan = WaitingScans(), scan_at(12.2)
    scans.add(scan)
    now = round(12.21 * SECOND)
    assert scans.release(12 * SECOND, now) == []
    assert list(scans.waiting) == [scan]
    assert scans.release(round(12.11 * SECOND), now) == [scan]
    assert not scans.waiting


@pytest.mark.parametrize("newest", [12.15, 12.2, 13.0, None])
def test_scan_does_not_wait_for_odometry_that_is_on_time(newest: float | None) -> None:
    scans, scan = WaitingScans(), scan_at(12.2)
    scans.add(scan)
    known = None if newest is None else round(newest * SECOND)
    assert scans.release(known, round(12.21 * SECOND)) == [scan]


def test_scan_waits_for_a_limited_time_and_not_for_the_future() -> None:
    scans, scan = WaitingScans(), scan_at(12.2)
    scans.add(scan)
    assert scans.release(11 * SECOND, round(12.6 * SECOND)) == []
    assert scans.release(11 * SECOND, round(12.71 * SECOND)) == [scan]
    scans.add(scan_at(99.0))
    assert len(scans.release(11 * SECOND, 13 * SECOND)) == 1


def test_number_of_waiting_scans_is_limited() -> None:
    scans = WaitingScans()
    for k in range(50):
        scans.add(scan_at(12.0 + 0.001 * k))
    assert len(scans.waiting) == 20
    assert scans.waiting[-1] == scan_at(12.049)
