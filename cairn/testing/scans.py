"""Judges scans: units, angles, limits, and what is seen where.

All raise `AssertionError` with a sentence that names the fault. Lengths are in meters, angles in
radians.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from cairn.schemas.sensor_msgs import LaserScan

_FARTHEST_M = 300.0  # no scanner that turns sees farther
_ROUNDING = 1e-5  # of float32, as a share
_TURN = 2.0 * math.pi


def check_frame(frames: Iterable[str], frame: str) -> None:
    """All messages are of that frame."""
    others = sorted({found for found in frames if found != frame})
    assert not others, f"frame_id is {', '.join(map(repr, others))}, but should be {frame!r}"


def check_limits(scan: LaserScan) -> None:
    """`range_min` and `range_max` are those of a scanner, in meters."""
    assert scan.ranges.size > 1, f"a scan has {scan.ranges.size} ranges"
    assert scan.range_max <= _FARTHEST_M, (
        f"range_max = {scan.range_max:g} m, and no scanner sees farther than {_FARTHEST_M:g} m: "
        "are these millimeters?"
    )
    assert 0.0 <= scan.range_min < scan.range_max, (
        f"range_min = {scan.range_min:g} m, range_max = {scan.range_max:g} m: there is no range"
    )


def check_ranges(scan: LaserScan) -> None:
    """Each range is within the limits, or says as in REP 117 why there is none."""
    finite = scan.ranges[np.isfinite(scan.ranges)].astype(float)
    low = scan.range_min * (1.0 - _ROUNDING)
    high = scan.range_max * (1.0 + _ROUNDING)
    wrong = finite[(finite < low) | (finite > high)]
    hint = ": are these millimeters?" if wrong.size and np.median(wrong) > 10 * high else ""
    assert not wrong.size, (
        f"{wrong.size} of {scan.ranges.size} ranges are outside of range_min = {scan.range_min:g} m"
        f" to range_max = {scan.range_max:g} m, such as {wrong[0]:g} m{hint}; too near is -inf, "
        "nothing hit is +inf, a failed measurement NaN (REP 117)"
    )


def check_angles(scan: LaserScan) -> None:
    """First, last, increment and number of beams agree, in radians, within one turn."""
    beams, step = scan.ranges.size, scan.angle_increment
    assert step != 0.0, "angle_increment = 0: all beams would point the same way"
    span = (beams - 1) * step
    assert abs(span) <= _TURN + abs(step), (
        f"{beams} beams {step:g} rad apart span {span:g} rad, more than a turn: are these degrees?"
    )
    assert abs(scan.angle_min + span - scan.angle_max) <= 0.5 * abs(step), (
        f"{beams} beams from angle_min = {scan.angle_min:g} rad, {step:g} rad apart, end at "
        f"{scan.angle_min + span:g} rad, but angle_max = {scan.angle_max:g} rad: it is that of the "
        "last beam"
    )
    outside = [angle for angle in (scan.angle_min, scan.angle_max) if abs(angle) > _TURN]
    assert not outside, f"an angle of {outside[0]:g} rad is beyond a turn: are these degrees?"


def check_times(scan: LaserScan, rate_hz: float, tolerance: float) -> None:
    """`scan_time` is that of the rate, where it is given; the sweep does not last longer."""
    sweep_s = sweep_time(scan)
    assert scan.time_increment >= 0.0, f"time_increment = {scan.time_increment:g} s is negative"
    if scan.scan_time == 0.0:
        return
    assert abs(scan.scan_time * rate_hz - 1.0) <= tolerance, (
        f"scan_time = {scan.scan_time:g} s, but at {rate_hz:g} Hz it is {1.0 / rate_hz:g} s"
    )
    assert sweep_s <= scan.scan_time * (1.0 + tolerance), (
        f"a sweep lasts {sweep_s:g} s by time_increment, but scan_time is {scan.scan_time:g} s"
    )


def sweep_time(scan: LaserScan) -> float:
    """From the first beam to the last [s]; 0 where the driver does not tell."""
    return (scan.ranges.size - 1) * scan.time_increment


def check_sees(
    scans: Sequence[LaserScan], surroundings: Mapping[float, float], tolerance_m: float
) -> None:
    """At each bearing [rad, left positive] of the surroundings is what stands there [m]."""
    for bearing, there in surroundings.items():
        seen = seen_at(scans, bearing)
        if abs(seen - there) <= tolerance_m:
            continue
        hint = ""
        if abs(seen_at(scans, -bearing) - there) <= tolerance_m:
            hint = "; it is seen on the other side: angles must count to the left (REP 103)"
        elif abs(seen / 1000.0 - there) <= tolerance_m:
            hint = "; a thousand times as far: are these millimeters?"
        raise AssertionError(
            f"at {math.degrees(bearing):g} degrees stands something {there:g} m away, but "
            f"{seen:g} m are measured{hint}"
        )


def seen_at(scans: Sequence[LaserScan], bearing: float) -> float:
    """The median of the ranges within a degree of a bearing [rad]; NaN if there are none [m]."""
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
