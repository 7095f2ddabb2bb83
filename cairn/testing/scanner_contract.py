"""The contract of a range scanner with the port `scan`, sensor_msgs/LaserScan.

A failed check raises `AssertionError`, which describes the fault. Units are meters and radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pytest

from cairn.schemas.sensor_msgs import LaserScan
from cairn.testing import timing as timed
from cairn.testing.driver_contract import DriverContract, StampedContract
from cairn.testing.robot import Arrival, Bench
from cairn.testing.timing import undisturbed

Scans = list[Arrival[LaserScan]]
_FARTHEST_M = 300.0  # no turning scanner measures farther
_ROUNDING = 1e-5  # of float32, as a share
_TURN = 2.0 * math.pi


class ScanContract(StampedContract):
    """Tests the contents and stamps of scans."""

    component: ClassVar[str] = "scanner"
    port: ClassVar[str] = "scan"
    message: ClassVar[type[Any]] = LaserScan

    live: ClassVar[bool] = True
    """False for a recording: its scans are published at the time of their stamps."""

    frame: ClassVar[str] = "laser"
    """Expected `frame_id` of the scans."""

    surroundings: ClassVar[Mapping[float, float]] = {}
    """Known ranges [m] around the scanner by bearing [rad, left positive]."""

    surroundings_m: ClassVar[float] = 0.1
    """Allowed difference between a known and a measured range [m]."""

    sample_count: ClassVar[int] = 20
    """Number of scans in a sample."""

    @pytest.fixture(scope="class")
    @classmethod
    def scans(cls, bench: Bench) -> Scans:
        """Return a sample of consecutive scans, which the tests of the class share."""
        robot = bench.robot(cls.component)
        with robot.read(cls.topic(robot, cls.port), LaserScan) as reading:
            return undisturbed(lambda: cls.sample(reading, cls.sample_count, after=reading.count))

    def test_rate_is_nominal(self, scans: Scans) -> None:
        """Scans arrive at the nominal rate, on which filters and watchdogs rely."""
        timed.check_rate(timed.stamps_of(scans), self.rate_hz, self.rate_tolerance)

    def test_stamps_increase_regularly(self, scans: Scans) -> None:
        """Each stamp is the time of that sweep. A constant or jumping stamp misplaces scans."""
        stamps = timed.stamps_of(scans)
        timed.check_increasing(stamps)
        timed.check_regular(stamps, self.jitter)

    def test_stamps_are_current(self, scans: Scans) -> None:
        """On arrival, stamps are neither too old nor in the future by the deployment's clock."""
        timed.check_present(scans, -self.early_s, self.oldest_s, self.early_s)

    def test_stamp_is_of_the_first_beam(self, scans: Scans) -> None:
        """The stamp is the time of the first beam, as sensor_msgs/LaserScan defines it.

        A scan is sent after its last beam, so on arrival it is at least as old as the sweep takes.
        """
        if not self.live:
            pytest.skip("a recording is published at the time of its stamps")
        sweep_s = sweep_time(scans[0].message)
        if sweep_s == 0.0:
            pytest.skip("time_increment = 0: the duration of a sweep is unknown")
        timed.check_present(scans, 0.9 * sweep_s, self.oldest_s + sweep_s, self.early_s)

    def test_frame_id_is_as_configured(self, scans: Scans) -> None:
        """All scans have the frame that tf and the maps use."""
        check_frame((scan.message.header.frame_id for scan in scans), self.frame)

    def test_limits_are_in_meters(self, scans: Scans) -> None:
        """`range_min` and `range_max` are in meters (REP 103)."""
        check_limits(scans[0].message)

    def test_ranges_are_within_limits(self, scans: Scans) -> None:
        """Each range is within the limits, or encodes why it is missing (REP 117)."""
        for scan in scans:
            check_ranges(scan.message)

    def test_some_ranges_are_measured(self, scans: Scans) -> None:
        """Some beams return. Otherwise the scanner is covered or defective."""
        returns = sum(int(np.isfinite(scan.message.ranges).sum()) for scan in scans)
        assert returns, f"none of {len(scans)} scans contains a finite range"

    def test_angle_fields_agree_with_the_number_of_beams(self, scans: Scans) -> None:
        """The angles agree with the number of beams, in radians; `angle_max` is the last beam."""
        for scan in scans:
            check_angles(scan.message)

    def test_time_fields_agree_with_the_rate(self, scans: Scans) -> None:
        """`scan_time` agrees with the rate and with `time_increment`, where they are set."""
        check_times(scans[0].message, self.rate_hz, max(self.rate_tolerance, self.jitter))

    def test_surroundings_are_measured_correctly(self, scans: Scans) -> None:
        """Known distances are measured at their bearings, left positive (REP 103), in meters."""
        if not self.surroundings:
            pytest.skip("surroundings is not set")
        messages = [scan.message for scan in scans]
        check_surroundings(messages, self.surroundings, self.surroundings_m)


class RangeScannerContract(DriverContract, ScanContract):
    """All tests of a range scanner's driver. Derive a class and set its attributes."""


def check_frame(frames: Iterable[str], frame: str) -> None:
    """Check that all messages have the frame `frame`."""
    others = sorted({found for found in frames if found != frame})
    assert not others, f"frame_id is {', '.join(map(repr, others))}, but should be {frame!r}"


def check_limits(scan: LaserScan) -> None:
    """Check that `range_min` and `range_max` are plausible limits in meters."""
    assert scan.ranges.size > 1, f"a scan has {scan.ranges.size} ranges"
    assert scan.range_max <= _FARTHEST_M, (
        f"range_max = {scan.range_max:g} m, but no scanner measures farther than "
        f"{_FARTHEST_M:g} m: are these millimeters?"
    )
    assert 0.0 <= scan.range_min < scan.range_max, (
        f"range_min = {scan.range_min:g} m and range_max = {scan.range_max:g} m allow no range"
    )


def check_ranges(scan: LaserScan) -> None:
    """Check that each range is within the limits, or encodes why it is missing (REP 117)."""
    finite = scan.ranges[np.isfinite(scan.ranges)].astype(float)
    low = scan.range_min * (1.0 - _ROUNDING)
    high = scan.range_max * (1.0 + _ROUNDING)
    wrong = finite[(finite < low) | (finite > high)]
    hint = ": are these millimeters?" if wrong.size and np.median(wrong) > 10 * high else ""
    assert not wrong.size, (
        f"{wrong.size} of {scan.ranges.size} ranges are outside of range_min = {scan.range_min:g} m"
        f" to range_max = {scan.range_max:g} m, such as {wrong[0]:g} m{hint}; use -inf for too "
        "near, +inf for nothing hit, NaN for a failed measurement (REP 117)"
    )


def check_angles(scan: LaserScan) -> None:
    """Check that angles, increment and number of beams agree, within one turn."""
    beams, step = scan.ranges.size, scan.angle_increment
    assert step != 0.0, "angle_increment = 0: all beams would have the same direction"
    span = (beams - 1) * step
    assert abs(span) <= _TURN + abs(step), (
        f"{beams} beams {step:g} rad apart span {span:g} rad, more than a turn: are these degrees?"
    )
    assert abs(scan.angle_min + span - scan.angle_max) <= 0.5 * abs(step), (
        f"{beams} beams from angle_min = {scan.angle_min:g} rad, {step:g} rad apart, end at "
        f"{scan.angle_min + span:g} rad, but angle_max = {scan.angle_max:g} rad; angle_max is the "
        "angle of the last beam"
    )
    outside = [angle for angle in (scan.angle_min, scan.angle_max) if abs(angle) > _TURN]
    assert not outside, f"an angle of {outside[0]:g} rad is beyond a turn: are these degrees?"


def check_times(scan: LaserScan, rate_hz: float, tolerance: float) -> None:
    """Check that `scan_time`, if set, is the period of the rate, and the sweep is not longer."""
    sweep_s = sweep_time(scan)
    assert scan.time_increment >= 0.0, f"time_increment = {scan.time_increment:g} s is negative"
    if scan.scan_time == 0.0:
        return
    assert abs(scan.scan_time * rate_hz - 1.0) <= tolerance, (
        f"scan_time = {scan.scan_time:g} s, but the period at {rate_hz:g} Hz is {1.0 / rate_hz:g} s"
    )
    assert sweep_s <= scan.scan_time * (1.0 + tolerance), (
        f"a sweep lasts {sweep_s:g} s by time_increment, but scan_time is {scan.scan_time:g} s"
    )


def sweep_time(scan: LaserScan) -> float:
    """Return the time from the first beam to the last [s]; 0 if `time_increment` is not set."""
    return (scan.ranges.size - 1) * scan.time_increment


def check_surroundings(
    scans: Sequence[LaserScan], surroundings: Mapping[float, float], tolerance_m: float
) -> None:
    """Check the measured range at each bearing of `surroundings`: {bearing [rad]: range [m]}."""
    for bearing, there in surroundings.items():
        measured = range_at(scans, bearing)
        if abs(measured - there) <= tolerance_m:
            continue
        hint = ""
        if abs(range_at(scans, -bearing) - there) <= tolerance_m:
            hint = "; it is measured on the other side: angles must increase to the left (REP 103)"
        elif abs(measured / 1000.0 - there) <= tolerance_m:
            hint = "; that is a thousand times as far: are these millimeters?"
        raise AssertionError(
            f"at {math.degrees(bearing):g} degrees the range is {there:g} m, but "
            f"{measured:g} m are measured{hint}"
        )


def range_at(scans: Sequence[LaserScan], bearing: float) -> float:
    """Return the median range [m] within one degree of a bearing [rad]; NaN without a range."""
    found: list[npt.NDArray[np.float32]] = []
    for scan in scans:
        angles = scan.angle_min + np.arange(scan.ranges.size) * scan.angle_increment
        away = np.abs((angles - bearing + math.pi) % _TURN - math.pi)
        near = away <= max(math.radians(1.0), away.min(initial=math.inf))
        if away.min(initial=math.inf) <= max(math.radians(1.0), abs(scan.angle_increment)):
            found.append(scan.ranges[near])
    measured = np.concatenate(found) if found else np.empty(0, np.float32)
    measured = measured[np.isfinite(measured)]
    return float(np.median(measured)) if measured.size else math.nan
