"""A scan's stamp is the time of its first ray, independent of the delays of the line."""

from __future__ import annotations

import numpy as np
import pytest

from cairn import SECOND
from cairn.components.hokuyo_scanner.client import ClockReading
from cairn.components.hokuyo_scanner.protocol import ScanRequest, SensorSpec
from cairn.components.hokuyo_scanner.stamping import ScanStamper

UTM = SensorSpec("UTM-30LX", 23, 60000, 1440, 0, 1080, 540, 2400)
REQUEST = ScanRequest(0, 1080)
COMPUTES_S = 0.004  # the sensor's computing time after the last ray


def errors_s(
    drift: float, *, readings: bool, start_ms: int = 0, seconds: float = 60.0
) -> list[float]:
    """Return the errors of stamps [s], once settled, for a sensor with such a clock."""
    random = np.random.default_rng(1)
    stamper = ScanStamper(UTM)

    def shown(true_s: float) -> int:
        return int((start_ms + true_s * 1000.0 * (1.0 + drift)) % 2**24)

    if readings:
        asked = 10.0 + 0.003 * np.arange(10)
        ways = random.uniform(0.0005, 0.002, (10, 2))
        assert stamper.calibrate(
            [
                ClockReading(
                    shown(at + way[0]), round(at * SECOND), round((at + way.sum()) * SECOND)
                )
                for at, way in zip(asked, ways, strict=True)
            ]
        )
    found = []
    for number in range(round(seconds * 40)):
        began = 11.0 + number * 0.025
        late = random.exponential(0.002) + (0.5 if number % 100 == 0 else 0.0)
        arrived = began + 0.025 * 1081 / 1440 + COMPUTES_S + late
        stamp = stamper.first_ray(shown(began), round(arrived * SECOND), REQUEST, 0.0)
        found.append(stamp / SECOND - began)
    return found[80:]


@pytest.mark.parametrize("drift", [0.0, 50e-6, -50e-6, 200e-6, -200e-6])
def test_stamps_use_the_sensors_clock_if_it_was_read(drift: float) -> None:
    assert np.abs(errors_s(drift, readings=True)).max() < 0.0025


def test_without_clock_readings_the_error_is_the_computing_time() -> None:
    errors = np.array(errors_s(0.0, readings=False)) - COMPUTES_S

    assert np.abs(errors).max() < 0.002


def test_stamps_continue_when_the_sensors_clock_wraps() -> None:
    errors = errors_s(0.0, readings=True, start_ms=2**24 - 30_000)

    assert np.abs(errors).max() < 0.0025


def test_contradictory_readings_are_not_used() -> None:
    readings = [ClockReading(0, 0, 1000), ClockReading(500, 2000, 3000)]

    assert not ScanStamper(UTM).calibrate(readings)
    assert not ScanStamper(UTM).calibrate([])


def test_without_a_clock_the_stamp_follows_from_the_arrival() -> None:
    stamp = ScanStamper(UTM).first_ray(None, 10 * SECOND, REQUEST, 0.05)

    assert stamp / SECOND == pytest.approx(10.0 - 0.05 - 0.025 * 1081 / 1440)


def test_stamp_is_that_of_the_first_requested_ray() -> None:
    whole, part = ScanStamper(UTM), ScanStamper(UTM)
    arrived = 10 * SECOND

    first = whole.first_ray(1000, arrived, ScanRequest(0, 1080), 0.0)
    later = part.first_ray(1000, arrived, ScanRequest(360, 1080), 0.0)

    assert (later - first) / SECOND == pytest.approx(0.025 * 360 / 1440)


@pytest.mark.parametrize("line_s", [0.0, 0.2])
def test_change_of_request_does_not_shift_the_stamps(line_s: float) -> None:
    stamper = ScanStamper(UTM)
    stamper.calibrate([ClockReading(0, 0, 500_000)])
    errors = []
    for number in range(400):
        request, line = (REQUEST, line_s) if number < 200 else (ScanRequest(0, 540), line_s / 10)
        began = 1.0 + number * 0.025
        arrived = began + 0.025 * (request.last + 1) / 1440 + COMPUTES_S + line
        stamp = stamper.first_ray(round(1000 * began), round(arrived * SECOND), request, line)
        errors.append(stamp / SECOND - began)

    assert np.abs(errors).max() < 0.002
    assert stamper.jumps == 0


@pytest.mark.parametrize("ran_ms", [1_000, 3_000_000, 10_000_000])
def test_restarted_sensor_is_followed_at_once(ran_ms: int) -> None:
    stamper = ScanStamper(UTM)
    stamper.calibrate([ClockReading(ran_ms, 0, 500_000)])
    errors = []
    for number in range(200):
        began = 1.0 + number * 0.025 + (0.4 if number >= 100 else 0.0)
        shown = ran_ms + round(1000 * began) if number < 100 else 7 + 25 * (number - 100)
        arrived = began + 0.025 * 1081 / 1440 + COMPUTES_S
        stamp = stamper.first_ray(shown, round(arrived * SECOND), REQUEST, 0.0)
        errors.append(stamp / SECOND - began)

    assert np.abs(errors).max() < 0.002
    assert stamper.jumps == 1
