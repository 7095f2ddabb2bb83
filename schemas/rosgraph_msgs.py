"""ROS 2 package rosgraph_msgs: simulated time."""

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.message import message


@message("rosgraph_msgs/msg/Clock")
class Clock:
    """The time now, where a simulator or a replay says what time it is."""

    clock: Time = Time()
