"""Scans become messages: ranges [m] of REP 117 at angles [rad] to the left."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cairn.components.hokuyo_scanner.messages import ScanMessages
from cairn.components.hokuyo_scanner.protocol import URG_04LX, ScanData, ScanRequest, SensorSpec
from cairn.schemas.std_msgs import Header

UTM = SensorSpec("UTM-30LX(Hokuyo)", 23, 60000, 1440, 0, 1080, 540, 2400)
HEADER = Header(frame_id="laser")


def data_of(*values: int) -> ScanData:
    return ScanData(0, np.array(values, np.int32).reshape(-1, 1))


def test_whole_scan_has_the_angles_and_times_of_the_model() -> None:
    request = ScanRequest(44, 725)
    messages = ScanMessages(URG_04LX, request)

    scan = messages.scan(data_of(*[1000] * 682), HEADER, "first")

    assert scan.angle_min == pytest.approx(-2 * math.pi * 340 / 1024)
    assert scan.angle_max == pytest.approx(2 * math.pi * 341 / 1024)
    assert scan.angle_increment == pytest.approx(2 * math.pi / 1024)
    assert scan.time_increment == pytest.approx(0.1 / 1024)
    assert scan.scan_time == pytest.approx(0.1)
    assert (scan.range_min, scan.range_max) == pytest.approx((0.02, 5.6))
    assert set(scan.ranges.tolist()) == {1.0}


def test_clusters_and_skipped_scans_change_increments_and_scan_time() -> None:
    request = ScanRequest(0, 1080, cluster=3, skip=3)
    messages = ScanMessages(UTM, request)

    scan = messages.scan(data_of(*[1000] * 361), HEADER, "first")

    assert scan.angle_increment == pytest.approx(3 * math.radians(0.25))
    assert scan.time_increment == pytest.approx(3 * 0.025 / 1440)
    assert scan.scan_time == pytest.approx(0.1)


def test_codes_become_inf_or_nan() -> None:
    messages = ScanMessages(UTM, ScanRequest(0, 7))
    urg = replace(messages, spec=URG_04LX)
    values = data_of(1, 2, 3, 22, 23, 60000, 60001, 65533)

    ours = messages.scan(values, HEADER, "first").ranges
    others = urg.scan(values, HEADER, "first").ranges

    nan = math.nan
    expected = [math.inf, -math.inf, nan, nan, 0.023, 60.0, math.inf, math.inf]
    assert ours.tolist() == pytest.approx(expected, nan_ok=True)
    assert others.tolist() == pytest.approx(
        [nan, nan, nan, 0.022, 0.023, math.inf, math.inf, math.inf], nan_ok=True
    )


def test_range_max_shortens_the_range() -> None:
    messages = ScanMessages(UTM, ScanRequest(0, 1), range_max=30.0)

    scan = messages.scan(data_of(30000, 30001), HEADER, "first")

    assert scan.ranges.tolist() == [30.0, math.inf]
    assert scan.range_max == 30.0


def test_chosen_echo_is_the_range() -> None:
    distances = np.array([[1000, 2000, 3000], [500, -1, -1], [700, 800, -1]], np.int32)
    strengths = np.array([[5, 9, 2], [1, -1, -1], [8, 3, -1]], np.int32)
    data = ScanData(0, distances, strengths)
    messages = ScanMessages(UTM, ScanRequest(0, 2, multi_echo=True, intensity=True))

    first, last, strongest = (
        messages.scan(data, HEADER, echo) for echo in ("first", "last", "strongest")
    )

    assert first.ranges.tolist() == pytest.approx([1.0, 0.5, 0.7])
    assert last.ranges.tolist() == pytest.approx([3.0, 0.5, 0.8])
    assert strongest.ranges.tolist() == pytest.approx([2.0, 0.5, 0.7])
    assert strongest.intensities.tolist() == [9, 1, 8]


def test_all_echoes_are_in_multi_echo_scans() -> None:
    distances = np.array([[1000, 2000, 1], [500, -1, -1]], np.int32)
    data = ScanData(0, distances, distances // 100)
    messages = ScanMessages(UTM, ScanRequest(0, 1, multi_echo=True, intensity=True))

    scan = messages.multi_echo_scan(data, HEADER)

    assert [echo.echoes.tolist() for echo in scan.ranges] == [[1.0, 2.0, math.inf], [0.5]]
    assert [echo.echoes.tolist() for echo in scan.intensities] == [[10.0, 20.0, 0.0], [5.0]]
