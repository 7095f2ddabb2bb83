"""Services of ROS 2 package tf2_msgs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.message import Service, message
from cairn.schemas.service_msgs import msg as service_msgs

@message("tf2_msgs/srv/FrameGraph_Request")
class FrameGraph_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("tf2_msgs/srv/FrameGraph_Response")
class FrameGraph_Response:
    frame_yaml: field_types.String = ...

@message("tf2_msgs/srv/FrameGraph_Event")
class FrameGraph_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[FrameGraph_Request, ...] = ...
    response: tuple[FrameGraph_Response, ...] = ...

class FrameGraph(Service[FrameGraph_Request, FrameGraph_Response]):
    Request: TypeAlias = FrameGraph_Request
    Response: TypeAlias = FrameGraph_Response
    Event: TypeAlias = FrameGraph_Event
