"""Messages of ROS 2 package unique_identifier_msgs."""

from cairn.schemas import field_types
from cairn.schemas.message import message

@message("unique_identifier_msgs/msg/UUID")
class UUID:
    uuid: field_types.UInt8Array = ...
