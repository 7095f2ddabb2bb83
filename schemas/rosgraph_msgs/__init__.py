"""ROS 2 package rosgraph_msgs: simulated time."""

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.message import message


@message("rosgraph_msgs/msg/Clock")
class Clock:
    """The current time of a simulation or a replay."""

    clock: Time = Time()
