"""ROS 2 package sensor_msgs: laser scans, camera images and batteries."""

import math
from typing import Annotated, ClassVar

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


@message("sensor_msgs/msg/LaserScan")
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
            step = self.angle_increment
            last = self.angle_min + (beams - 1) * step
            # Some drivers count the beams, some the gaps: tolerate one step. The increment is
            # rounded to float32, and the error adds up over the beams.
            rounding = (
                2 * _EPSILON * (abs(self.angle_min) + abs(self.angle_max) + beams * abs(step))
            )
            if abs(last - self.angle_max) > abs(step) + rounding:
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


@message("sensor_msgs/msg/MultiEchoLaserScan")
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


@message("sensor_msgs/msg/Image")
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
