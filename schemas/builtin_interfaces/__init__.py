"""ROS 2 package builtin_interfaces: points in time and durations."""

from typing import Annotated

from cairn.schemas.field_types import Int32, Scalar
from cairn.schemas.message import message
from cairn.system.clock import SECOND

Nanoseconds = Annotated[int, Scalar("uint32", at_most=999_999_999)]


@message("builtin_interfaces/msg/Time")
class Time:
    """A point in time: seconds since the clock's epoch, plus nanoseconds."""

    sec: Int32 = 0
    nanosec: Nanoseconds = 0


@message("builtin_interfaces/msg/Duration")
class Duration:
    """A duration: seconds, which may be negative, plus nanoseconds."""

    sec: Int32 = 0
    nanosec: Nanoseconds = 0


def to_ns(stamp: Time) -> int:
    """Return a message's time stamp in nanoseconds."""
    return stamp.sec * SECOND + stamp.nanosec


def from_ns(nanoseconds: int) -> Time:
    """Return nanoseconds as a message's time stamp.

    Raises `InvalidMessage` if the seconds do not fit an int32 (years 1901 to 2038).
    """
    sec, nanosec = divmod(nanoseconds, SECOND)
    return Time(sec=sec, nanosec=nanosec)
