"""ROS 2 package builtin_interfaces: points in time and durations."""

from typing import Annotated

from cairn.schemas.field_types import Int32, Scalar
from cairn.schemas.message import message

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
