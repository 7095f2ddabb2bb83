"""The turtle's own message types; everything else it says is standard ROS 2."""

from typing import Annotated

from cairn.schemas.field_types import Bool, Scalar
from cairn.schemas.message import message
from cairn.schemas.std_msgs import Header

Share = Annotated[float, Scalar("float32", at_least=0, at_most=1)]


@message("turtle_msgs/msg/BaseState")
class BaseState:
    """How the base is: charge of its battery [share of full], and whether the wall stops it."""

    header: Header = Header()
    charge: Share = 1.0
    blocked: Bool = False
