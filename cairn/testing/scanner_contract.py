"""The contract of a range scanner: `scan`, sensor_msgs/LaserScan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pytest

from cairn.schemas.sensor_msgs import LaserScan
from cairn.testing import scans as judged
from cairn.testing import stamps as timed
from cairn.testing.bench import Bench
from cairn.testing.driver_contract import Contract, LifeCycleContract, ParametersContract
from cairn.testing.end_contract import EndContract, StopContract, UnplugContract
from cairn.testing.pauses import undisturbed
from cairn.testing.reading import Arrival

Scans = list[Arrival[LaserScan]]


class ScanContract(Contract):
    """What a scan says, and when."""

    component: ClassVar[str] = "scanner"
    port: ClassVar[str] = "scan"
    message: ClassVar[type[Any]] = LaserScan

    rate_tolerance: ClassVar[float] = 0.1
    """How far the rate may be off the nominal one, as a share."""

    jitter: ClassVar[float] = 0.3
    """How far a spacing of stamps may be off the median, as a share."""

    oldest_s: ClassVar[float] = 0.5
    """How old a scan may be when it comes [s]."""

    early_s: ClassVar[float] = 0.005
    """By how much a stamp may be in the future [s]."""

    live: ClassVar[bool] = True
    """False for a recording, which is told at the very time that it bears."""

    frame: ClassVar[str] = "laser"
    """The frame of the scans."""

    surroundings: ClassVar[Mapping[float, float]] = {}
    """What stands around the scanner: ranges [m] by bearing [rad, left positive]."""

    surroundings_m: ClassVar[float] = 0.1
    """How well these are known and measured [m]."""

    sample_count: ClassVar[int] = 20
    """How many scans are judged."""

    @pytest.fixture(scope="class")
    @classmethod
    def scans(cls, bench: Bench) -> Scans:
        """Scans in a row, that the tests of the class share."""
        robot = bench.robot(cls.component)
        with robot.read(cls.topic(robot, cls.port), LaserScan) as reading:
            return undisturbed(lambda: cls.sample(reading, cls.sample_count, after=reading.count))

    def test_rate(self, scans: Scans) -> None:
        """It is the nominal one: who plans by it (filters, watchdogs) relies on it."""
        timed.check_rate(timed.stamps_of(scans), self.rate_hz, self.rate_tolerance)

    def test_stamps_increase_regularly(self, scans: Scans) -> None:
        """Each is of its own sweep: a constant, repeated or jumping stamp puts scans elsewhere."""
        stamps = timed.stamps_of(scans)
        timed.check_increasing(stamps)
        timed.check_regular(stamps, self.jitter)

    def test_stamps_are_of_the_present(self, scans: Scans) -> None:
        """Neither of the future nor of long ago, by the deployment's clock."""
        timed.check_present(scans, -self.early_s, self.oldest_s, self.early_s)

    def test_stamp_is_of_the_first_beam(self, scans: Scans) -> None:
        """As sensor_msgs/LaserScan says; a scan is sent when its last beam is measured."""
        if not self.live:
            pytest.skip("a recording is told at the very time that it bears")
        sweep_s = judged.sweep_time(scans[0].message)
        if sweep_s == 0.0:
            pytest.skip("time_increment = 0: the driver does not tell how long a sweep lasts")
        timed.check_present(scans, 0.9 * sweep_s, self.oldest_s + sweep_s, self.early_s)

    def test_frame(self, scans: Scans) -> None:
        """All scans are of the frame that transforms and maps know."""
        judged.check_frame((scan.message.header.frame_id for scan in scans), self.frame)

    def test_limits_are_in_meters(self, scans: Scans) -> None:
        """`range_min` and `range_max` (REP 103: SI units)."""
        judged.check_limits(scans[0].message)

    def test_ranges_are_within_limits(self, scans: Scans) -> None:
        """Or say why there is no range (REP 117)."""
        for scan in scans:
            judged.check_ranges(scan.message)

    def test_something_is_seen(self, scans: Scans) -> None:
        """A scanner that never measures anything is covered, or broken."""
        returns = sum(int(np.isfinite(scan.message.ranges).sum()) for scan in scans)
        assert returns, f"none of {len(scans)} scans holds a range"

    def test_angles_agree(self, scans: Scans) -> None:
        """In radians; `angle_max` is that of the last beam; all scans have the same."""
        for scan in scans:
            judged.check_angles(scan.message)

    def test_times_agree(self, scans: Scans) -> None:
        """`scan_time` and `time_increment`, where they are given."""
        judged.check_times(scans[0].message, self.rate_hz, max(self.rate_tolerance, self.jitter))

    def test_surroundings_are_seen_where_they_are(self, scans: Scans) -> None:
        """Left is left, and a meter is a meter."""
        if not self.surroundings:
            pytest.skip("surroundings tells nothing of what stands around the scanner")
        messages = [scan.message for scan in scans]
        judged.check_sees(messages, self.surroundings, self.surroundings_m)


class RangeScannerContract(
    EndContract, StopContract, UnplugContract, LifeCycleContract, ParametersContract, ScanContract
):
    """All that a driver of a range scanner keeps to; derive from it and say what is yours."""
