"""The driver of a scanner behind ROS 2 in virtual time: which scans it publishes; its health."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cairn import SECOND, from_ns, to_ns
from cairn.components.ros2_devices.scanner import Ros2Scanner
from cairn.planar.scans import beams_of
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness


class Scanner(ComponentHarness[Ros2Scanner]):
    """The driver, and a node that publishes scans ten times per second."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__(Ros2Scanner, parameters, start_s=10.0, topics={"source_scan": "/scan"})

    def measured(self, age_s: float = 0.0, **fields: Any) -> LaserScan:
        scan = LaserScan(
            header=Header(stamp=from_ns(self.now_ns - round(age_s * SECOND)), frame_id="laser"),
            angle_min=-1.0,
            angle_max=1.0,
            angle_increment=0.5,
            range_min=0.0,
            range_max=8.0,
            ranges=np.array([1.0, 2.0, math.inf, math.nan, 0.0], np.float32),
        )
        return replace(scan, **fields)

    def run(self, seconds: float, **fields: Any) -> None:
        """Let time pass, with a scan ten times per second."""
        for _ in range(round(seconds * 10)):
            self.publish("source_scan", self.measured(**fields))
            self.run_for(0.1)

    def health(self) -> tuple[int, str]:
        """Return the newest level and message of its diagnostics."""
        status = self.take("diagnostics")[-1].status[0]
        return status.level, status.message


def test_scan_is_published_with_its_stamp_and_ranges_as_rep_117_has_them() -> None:
    scanner = Scanner(source_frame="base_scan")
    sent = scanner.measured(age_s=0.05)
    sent = replace(sent, header=replace(sent.header, frame_id="base_scan"))

    scanner.publish("source_scan", sent)

    (scan,) = scanner.take("scan")
    assert (scan.header.stamp, scan.header.frame_id) == (sent.header.stamp, "laser")
    ranges = beams_of(scan, (0.0, 0.0, 0.0)).ranges
    assert ranges.tolist() == pytest.approx([1.0, 2.0, math.inf, math.nan, math.nan], nan_ok=True)


def test_scanner_that_is_upside_down_has_its_first_beam_on_the_left() -> None:
    scanner = Scanner(upside_down=True)

    scanner.publish("source_scan", scanner.measured())

    (scan,) = scanner.take("scan")
    assert beams_of(scan, (0.0, 0.0, 0.0)).angles[0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"age_s": 0.8}, "/scan is 0.80 s old on arrival; synchronize both computers' clocks"),
        ({"age_s": -0.5}, "/scan is 0.50 s in the future on arrival"),
        (
            {"header": Header(frame_id="base_scan")},
            "frame 'base_scan', not 'laser'; set source_frame",
        ),
        ({"ranges": np.zeros(0, np.float32)}, "/scan has no ranges; correct the node"),
        (
            {"ranges": np.ones(10_001, np.float32), "angle_increment": 2e-4},
            "/scan has 10,001 ranges, more than 10,000",
        ),
        ({"angle_max": -1.0, "angle_increment": 0.0}, "have one direction: its angle_increment is"),
        ({"time_increment": 1.0}, "takes 4.0 s, with 5 beams 1 s apart"),
    ],
    ids=[
        "old",
        "of the future",
        "of another frame",
        "empty",
        "too many beams",
        "one direction",
        "slow",
    ],
)
def test_unusable_scan_is_rejected_with_topic_value_and_remedy(
    fields: dict[str, Any], reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    scanner = Scanner(timeout_s=10)
    caplog.clear()

    scanner.run(5.0, **fields)

    assert scanner.take("scan") == []
    level, message = scanner.health()
    assert (level, message.startswith("no scan is published: ")) == (2, True)
    assert reason in message
    logged = [one.message for one in caplog.records if reason in one.message]
    assert 1 <= len(logged) <= 12, "at 1, 2, 4, 8 ... of both subjects"


def test_scans_that_arrive_twice_or_out_of_order_are_published_once() -> None:
    scanner = Scanner()
    scanner.run(0.3)
    repeated = scanner.measured()
    for scan in (repeated, repeated, scanner.measured(age_s=0.05)):
        scanner.publish("source_scan", scan)

    assert len(scanner.take("scan")) == 4
    scanner.run_for(0.1)
    scanner.run(1.0)
    assert len(scanner.take("scan")) == 10


def test_silence_and_a_low_rate_are_reported_and_so_is_their_end() -> None:
    scanner = Scanner()
    scanner.run(2.0)
    assert scanner.health() == (0, "scans arrive")

    scanner.run_for(2.0)
    level, message = scanner.health()
    assert level == 2
    assert "does not arrive on /scan; check that its node runs" in message

    for _ in range(5):
        scanner.publish("source_scan", scanner.measured())
        scanner.run_for(0.4)
    assert scanner.health() == (1, "the scan arrives on /scan at 2.5 Hz instead of 10 Hz")
    scanner.run(6.0)
    assert scanner.health() == (0, "scans arrive")


def test_scans_can_be_stamped_on_arrival() -> None:
    scanner = Scanner(stamp_on_arrival=True, time_offset_s=-0.1)

    scanner.publish("source_scan", scanner.measured(age_s=9.0))

    (scan,) = scanner.take("scan")
    assert to_ns(scan.header.stamp) == scanner.now_ns - SECOND // 10
