"""ROS 2 package sensor_msgs: laser scans, camera images and batteries."""

import math
import re
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from cairn.schemas.field_types import (
    Array,
    Bool,
    FiniteFloat32,
    Float32,
    Float32Array,
    String,
    UInt8,
    UInt8Array,
    UInt32,
    empty,
    finite,
    zeros,
)
from cairn.schemas.message import message, reject
from cairn.schemas.std_msgs import Header

_EPSILON = float(np.finfo(np.float32).eps)

Coefficients = Annotated[npt.NDArray[np.float64], Array("float64", check=finite)]
Matrix3x3 = Annotated[npt.NDArray[np.float64], Array("float64", length=9, check=finite)]
Matrix3x4 = Annotated[npt.NDArray[np.float64], Array("float64", length=12, check=finite)]


_MOST_TURN: Final = 2.5 * math.pi
"""Most that the beams of a sweep may turn [rad]: some scanners turn a little more than once."""

_LONGEST_SWEEP_S: Final = 10.0
"""No scanner takes longer for a sweep [s]: a time in other units, as milliseconds, is."""

_ANY_REACH: Final = 100.0
"""Reach of a scanner that does not say it [m]: more than those of mobile robots have."""


def _repair_scan(values: dict[str, Any]) -> list[str]:
    """Repair a scan: the number of ranges, `angle_min` and `angle_increment` define the beams."""
    ranges = values["ranges"]
    repairs = _repair_sweep(values, ranges.size)
    if values["intensities"].size not in (0, ranges.size):
        values["intensities"] = ranges[:0]
        repairs.append("intensities left out: their number is not that of the ranges")
    if not 0.0 < values["range_max"] < math.inf:
        # How far a beam without a return was free is not known: it has measured nothing.
        measured = np.where(ranges == math.inf, np.float32(math.nan), ranges)
        farthest = np.nanmax(measured, initial=np.float32(max(_ANY_REACH, values["range_min"])))
        values["ranges"] = measured
        values["range_max"] = float(np.nextafter(farthest, np.float32(math.inf)))
        repairs.append("range_max is not set: beams without a return are unknown")
    elif values["range_min"] > values["range_max"]:
        values["range_min"] = 0.0
        repairs.append("range_min is above range_max: 0")
    return repairs


def _repair_sweep(values: dict[str, Any], beams: int) -> list[str]:
    """Repair what scans with one echo or several have in common."""
    repairs = []
    for name, consequence in (
        ("time_increment", "0, all beams at once"),
        ("scan_time", "0, not known"),
    ):
        if not math.isfinite(values[name]):
            values[name] = 0.0
            repairs.append(f"{name} is not a finite number: {consequence}")
    if abs(values["time_increment"]) * (beams - 1) > _LONGEST_SWEEP_S:
        values["time_increment"] = 0.0
        repairs.append("time_increment makes a sweep longer than 10 s: 0, all beams at once")
    if not values["range_min"] >= 0.0 or values["range_min"] == math.inf:
        values["range_min"] = 0.0
        repairs.append("range_min is not a finite number of at least 0: 0")
    first, last, step = (values[f"angle_{name}"] for name in ("min", "max", "increment"))
    if beams > 1 and not (step and math.isfinite(step)) and math.isfinite(last - first):
        step = values["angle_increment"] = (last - first) / (beams - 1)
        repairs.append("angle_increment is not set: by angle_min, angle_max and the ranges")
    elif beams <= 1 and not math.isfinite(step):
        step = values["angle_increment"] = 0.0
        repairs.append("angle_increment of a single beam is not a finite number: 0")
    if not math.isfinite(first) and math.isfinite(last):
        first = values["angle_min"] = last - (beams - 1) * step
        repairs.append("angle_min is not a finite number: by angle_max and the ranges")
    if _apart(last, end := first + max(0, beams - 1) * step, first, step, beams):
        values["angle_max"] = end
        repairs.append("angle_max is not that of the last beam: by the number of ranges")
    return repairs


def _apart(angle: float, other: float, first: float, step: float, beams: int) -> bool:
    """Return whether two directions of the last beam differ by more than a step."""
    # Some drivers count the beams, some the gaps: tolerate one step. The increment is rounded to
    # float32, and the error adds up over the beams.
    rounding = 2 * _EPSILON * (abs(first) + abs(angle) + beams * abs(step))
    return not abs(other - angle) <= abs(step) + rounding


@message("sensor_msgs/msg/LaserScan", repair=_repair_scan)
class LaserScan:
    """One sweep of a planar laser: `ranges` [m] at angles from `angle_min` [rad], left positive.

    As in REP 117 a range is -inf if the object is too near, +inf if nothing was hit, and NaN if
    the measurement failed. With any ranges, `range_max` [m] is required.
    """

    header: Header = Header()
    angle_min: FiniteFloat32 = 0.0
    angle_max: FiniteFloat32 = 0.0
    angle_increment: FiniteFloat32 = 0.0
    time_increment: FiniteFloat32 = 0.0
    scan_time: FiniteFloat32 = 0.0
    range_min: FiniteFloat32 = 0.0
    range_max: Float32 = 0.0
    ranges: Float32Array = empty(np.float32)
    intensities: Float32Array = empty(np.float32)

    def __post_init__(self) -> None:
        """Check the numbers of angles, ranges and intensities, and the limits of ranges."""
        beams = self.ranges.size
        if self.intensities.size not in (0, beams):
            reject(self, "intensities", self.intensities, f"must be none or {beams}, as the ranges")
        if not self.range_min <= self.range_max:
            reject(
                self, "range_max", self.range_max, f"must be range_min = {self.range_min} or more"
            )
        if beams:
            # A range of range_max or more means no return: with 0, all space would be free.
            if not 0.0 < self.range_max < math.inf:
                reject(self, "range_max", self.range_max, "must be above 0 and finite")
            if self.range_min < 0.0:
                reject(self, "range_min", self.range_min, "must be at least 0")
            sweep_s = abs(self.time_increment) * (beams - 1)
            if sweep_s > _LONGEST_SWEEP_S:
                reject(
                    self, "time_increment", self.time_increment, f"makes a sweep of {sweep_s:g} s"
                )
            step = self.angle_increment
            turn = abs(step) * (beams - 1)
            if turn > _MOST_TURN:
                reject(
                    self,
                    "angle_increment",
                    step,
                    f"makes {beams} beams turn by {turn:.6g} rad, far more than once: it is in "
                    "radians (REP 103), not in degrees",
                )
            last = self.angle_min + (beams - 1) * step
            if _apart(self.angle_max, last, self.angle_min, step, beams):
                reject(
                    self,
                    "angle_max",
                    self.angle_max,
                    f"must be within a step of the last of {beams} beams, at {last:.6g}",
                )


@message("sensor_msgs/msg/LaserEcho")
class LaserEcho:
    """The echoes of one laser beam: ranges [m], or intensities; the nearest first."""

    echoes: Float32Array = empty(np.float32)


def _repair_echoes(values: dict[str, Any]) -> list[str]:
    """Repair a scan with several echoes, as far as it says the same as one with one."""
    repairs = _repair_sweep(values, len(values["ranges"]))
    counts = [[echo.echoes.size for echo in values[name]] for name in ("ranges", "intensities")]
    if counts[1] and counts[0] != counts[1]:
        values["intensities"] = ()
        repairs.append("intensities left out: their number is not that of the ranges")
    return repairs


@message("sensor_msgs/msg/MultiEchoLaserScan", repair=_repair_echoes)
class MultiEchoLaserScan:
    """One sweep of a planar laser with several echoes per beam; otherwise as `LaserScan`."""

    header: Header = Header()
    angle_min: FiniteFloat32 = 0.0
    angle_max: FiniteFloat32 = 0.0
    angle_increment: FiniteFloat32 = 0.0
    time_increment: FiniteFloat32 = 0.0
    scan_time: FiniteFloat32 = 0.0
    range_min: FiniteFloat32 = 0.0
    range_max: Float32 = 0.0
    ranges: tuple[LaserEcho, ...] = ()
    intensities: tuple[LaserEcho, ...] = ()

    def __post_init__(self) -> None:
        """Check that there are as many intensities as ranges, echo by echo."""
        if self.intensities and [echo.echoes.size for echo in self.intensities] != [
            echo.echoes.size for echo in self.ranges
        ]:
            reject(self, "intensities", self.intensities, "must be none, or one for each range")


_PIXEL = re.compile(
    "(?:mono|rgba?|bgra?|bayer_(?:rggb|bggr|gbrg|grbg))(?P<bits>8|16)"
    "|(?P<plain>8|16|32|64)[USF]C(?P<channels>[0-9]{0,3})"
    "|(?P<pair>yuv422|uyvy|yuv422_yuy2|yuyv)|(?P<planes>nv12|nv21|nv24)"
)


def pixel_layout(encoding: str) -> tuple[int, int] | None:
    """Return the bytes of a number, and the numbers of a pixel, in the rows of an image.

    None if the encoding is not known. Source: sensor_msgs/image_encodings.hpp.
    """
    matched = _PIXEL.fullmatch(encoding)
    if matched is None:
        return None
    if matched["pair"] or matched["planes"]:  # of these the colors are behind the rows
        return 1, 2 if matched["pair"] else 1
    if matched["plain"]:
        return int(matched["plain"]) // 8, int(matched["channels"] or 1)
    colors = 1 if encoding[0] == "m" or encoding[:2] == "ba" else encoding.count("a") + 3
    return int(matched["bits"]) // 8, colors


def _repair_image(values: dict[str, Any]) -> list[str]:
    """Repair an image: its size, its encoding and the number of its bytes define the rows."""
    height, width, step, data = (values[name] for name in ("height", "width", "step", "data"))
    row = width * math.prod(pixel_layout(values["encoding"]) or (0,))
    if not height or not row:
        return []
    repairs = []
    if step < row and data.size >= height * row:
        step = values["step"] = data.size // height if data.size % height == 0 else row
        repairs.append("step is less than a row of pixels: by the number of bytes")
    if data.size > height * step:
        values["data"] = data[: height * step]
        repairs.append("bytes behind the last row left out")
    elif height * step - (step - row) <= data.size < height * step:
        values["data"] = np.pad(data, (0, height * step - data.size))
        repairs.append("padding of the last row added")
    return repairs


@message("sensor_msgs/msg/Image", repair=_repair_image)
class Image:
    """An uncompressed image: `height` rows of `step` bytes, pixels as `encoding` says."""

    header: Header = Header()
    height: UInt32 = 0
    width: UInt32 = 0
    encoding: String = ""
    is_bigendian: UInt8 = 0
    step: UInt32 = 0
    data: UInt8Array = empty(np.uint8)

    def __post_init__(self) -> None:
        """Check that `data` has `height` rows of `step` bytes."""
        size = self.height * self.step
        if self.data.size != size:
            reject(self, "data", self.data, f"must have height * step = {size} bytes")


@message("sensor_msgs/msg/RegionOfInterest")
class RegionOfInterest:
    """A part of an image [pixels]; all zeros means the whole."""

    x_offset: UInt32 = 0
    y_offset: UInt32 = 0
    height: UInt32 = 0
    width: UInt32 = 0
    do_rectify: Bool = False


@message("sensor_msgs/msg/CameraInfo")
class CameraInfo:
    """A camera's calibration: distortion `d`, intrinsics `k`, rectification `r`, projection `p`."""

    header: Header = Header()
    height: UInt32 = 0
    width: UInt32 = 0
    distortion_model: String = ""
    d: Coefficients = empty(np.float64)
    k: Matrix3x3 = zeros(9)
    r: Matrix3x3 = zeros(9)
    p: Matrix3x4 = zeros(12)
    binning_x: UInt32 = 0
    binning_y: UInt32 = 0
    roi: RegionOfInterest = RegionOfInterest()


@message("sensor_msgs/msg/BatteryState")
class BatteryState:
    """A battery: voltage [V], temperature [deg C], current [A], negative while it discharges.

    `charge`, `capacity` and `design_capacity` are in Ah, `percentage` is 0 to 1. Values that
    are not measured are NaN.
    """

    POWER_SUPPLY_STATUS_UNKNOWN: ClassVar[UInt8] = 0
    POWER_SUPPLY_STATUS_CHARGING: ClassVar[UInt8] = 1
    POWER_SUPPLY_STATUS_DISCHARGING: ClassVar[UInt8] = 2
    POWER_SUPPLY_STATUS_NOT_CHARGING: ClassVar[UInt8] = 3
    POWER_SUPPLY_STATUS_FULL: ClassVar[UInt8] = 4
    POWER_SUPPLY_HEALTH_UNKNOWN: ClassVar[UInt8] = 0
    POWER_SUPPLY_HEALTH_GOOD: ClassVar[UInt8] = 1
    POWER_SUPPLY_HEALTH_OVERHEAT: ClassVar[UInt8] = 2
    POWER_SUPPLY_HEALTH_DEAD: ClassVar[UInt8] = 3
    POWER_SUPPLY_HEALTH_OVERVOLTAGE: ClassVar[UInt8] = 4
    POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: ClassVar[UInt8] = 5
    POWER_SUPPLY_HEALTH_COLD: ClassVar[UInt8] = 6
    POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: ClassVar[UInt8] = 7
    POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: ClassVar[UInt8] = 8
    POWER_SUPPLY_TECHNOLOGY_UNKNOWN: ClassVar[UInt8] = 0
    POWER_SUPPLY_TECHNOLOGY_NIMH: ClassVar[UInt8] = 1
    POWER_SUPPLY_TECHNOLOGY_LION: ClassVar[UInt8] = 2
    POWER_SUPPLY_TECHNOLOGY_LIPO: ClassVar[UInt8] = 3
    POWER_SUPPLY_TECHNOLOGY_LIFE: ClassVar[UInt8] = 4
    POWER_SUPPLY_TECHNOLOGY_NICD: ClassVar[UInt8] = 5
    POWER_SUPPLY_TECHNOLOGY_LIMN: ClassVar[UInt8] = 6
    POWER_SUPPLY_TECHNOLOGY_TERNARY: ClassVar[UInt8] = 7
    POWER_SUPPLY_TECHNOLOGY_VRLA: ClassVar[UInt8] = 8
    header: Header = Header()
    voltage: Float32 = math.nan
    temperature: Float32 = math.nan
    current: Float32 = math.nan
    charge: Float32 = math.nan
    capacity: Float32 = math.nan
    design_capacity: Float32 = math.nan
    percentage: Float32 = math.nan
    power_supply_status: UInt8 = 0
    power_supply_health: UInt8 = 0
    power_supply_technology: UInt8 = 0
    present: Bool = False
    cell_voltage: Float32Array = empty(np.float32)
    cell_temperature: Float32Array = empty(np.float32)
    location: String = ""
    serial_number: String = ""
