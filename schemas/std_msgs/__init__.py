"""ROS 2 package std_msgs: the header of stamped messages, and bare values."""

from cairn.schemas import field_types
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.message import message


@message("std_msgs/msg/Header")
class Header:
    """Time and coordinate frame of the data in a message."""

    stamp: Time = Time()
    frame_id: field_types.String = ""


@message("std_msgs/msg/String")
class String:
    """A text."""

    data: field_types.String = ""


@message("std_msgs/msg/Bool")
class Bool:
    """A truth value."""

    data: field_types.Bool = False
