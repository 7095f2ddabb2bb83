"""ROS 2 package diagnostic_msgs: the health of devices and components."""

from typing import Annotated, ClassVar

from cairn.schemas.field_types import Byte, Scalar, String
from cairn.schemas.message import message
from cairn.schemas.std_msgs import Header


@message("diagnostic_msgs/msg/KeyValue")
class KeyValue:
    """A named value, as text."""

    key: String = ""
    value: String = ""


@message("diagnostic_msgs/msg/DiagnosticStatus")
class DiagnosticStatus:
    """The health of one part of the robot."""

    OK: ClassVar[Byte] = 0
    WARN: ClassVar[Byte] = 1
    ERROR: ClassVar[Byte] = 2
    STALE: ClassVar[Byte] = 3

    level: Annotated[int, Scalar("byte", at_most=3)] = 0
    name: String = ""
    message: String = ""
    hardware_id: String = ""
    values: tuple[KeyValue, ...] = ()


@message("diagnostic_msgs/msg/DiagnosticArray")
class DiagnosticArray:
    """The health of several parts of the robot."""

    header: Header = Header()
    status: tuple[DiagnosticStatus, ...] = ()
