"""Scans of ROS 2 nodes: whether they are usable, and their form in Cairn."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from cairn.planar.scans import has_directions, sweep_s
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

# A scan is placed by the odometry of its whole sweep, for which its users wait.
_LONGEST_SWEEP_S: Final = 1.0
# Each user computes with every beam of every scan; the finest scanners have about 7,000.
_MOST_BEAMS: Final = 10_000


def why_unusable(scan: LaserScan, topic: str, frame: str) -> str | None:
    """Return why a scan cannot be used, as a sentence; None if it can.

    `LaserScan` itself has checked limits, numbers of values, and that the angles fit the beams. A
    scan that names no frame is of the scanner's.
    """
    if scan.header.frame_id.strip("/") not in ("", frame.strip("/")):
        return (
            f"the scan on {topic} is of frame {scan.header.frame_id!r}, not {frame!r}; set "
            "source_frame, or correct the topic"
        )
    if not scan.ranges.size:
        return f"the scan on {topic} has no ranges; correct the node that publishes it"
    if scan.ranges.size > _MOST_BEAMS:
        return (
            f"the scan on {topic} has {scan.ranges.size:,} ranges, more than {_MOST_BEAMS:,}; let "
            "its node publish fewer"
        )
    if not has_directions(scan):
        return f"the beams of the scan on {topic} have one direction: its angle_increment is 0"
    if sweep_s(scan) > _LONGEST_SWEEP_S:
        return (
            f"the scan on {topic} takes {sweep_s(scan):.1f} s, with {scan.ranges.size} beams "
            f"{scan.time_increment:g} s apart; correct time_increment in the node's settings"
        )
    return None


def scan_message(scan: LaserScan, header: Header, *, upside_down: bool) -> LaserScan:
    """Return a scan with another header; with mirrored angles if the scanner is upside down."""
    side = -1.0 if upside_down else 1.0
    return replace(
        scan,
        header=header,
        angle_min=side * scan.angle_min,
        angle_max=side * scan.angle_max,
        angle_increment=side * scan.angle_increment,
    )
