"""ROS 2 package rcl_interfaces: log records."""

from typing import ClassVar

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.field_types import String, UInt8, UInt32
from cairn.schemas.message import message


@message("rcl_interfaces/msg/Log")
class Log:
    """One record of a node's log, as on the topic /rosout."""

    DEBUG: ClassVar[UInt8] = 10
    INFO: ClassVar[UInt8] = 20
    WARN: ClassVar[UInt8] = 30
    ERROR: ClassVar[UInt8] = 40
    FATAL: ClassVar[UInt8] = 50

    stamp: Time = Time()
    level: UInt8 = 0
    name: String = ""
    msg: String = ""
    file: String = ""
    function: String = ""
    line: UInt32 = 0
