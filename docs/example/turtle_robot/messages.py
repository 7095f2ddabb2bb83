"""The turtle's own message types; all others are standard ROS 2."""

from typing import Annotated

from cairn.schemas.field_types import Bool, Scalar
from cairn.schemas.message import message
from cairn.schemas.std_msgs import Header

Share = Annotated[float, Scalar("float32", at_least=0, at_most=1)]


@message("turtle_msgs/msg/BaseState")
class BaseState:
    """State of the base: battery charge [share of full], and whether a wall blocks it."""

    header: Header = Header()
    charge: Share = 1.0
    blocked: Bool = False
