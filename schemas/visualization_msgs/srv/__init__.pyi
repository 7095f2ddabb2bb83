"""Services of ROS 2 package visualization_msgs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.message import Service, message
from cairn.schemas.service_msgs import msg as service_msgs
from cairn.schemas.visualization_msgs import msg as visualization_msgs

@message("visualization_msgs/srv/GetInteractiveMarkers_Request")
class GetInteractiveMarkers_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("visualization_msgs/srv/GetInteractiveMarkers_Response")
class GetInteractiveMarkers_Response:
    sequence_number: field_types.UInt64 = ...
    markers: tuple[visualization_msgs.InteractiveMarker, ...] = ...

@message("visualization_msgs/srv/GetInteractiveMarkers_Event")
class GetInteractiveMarkers_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetInteractiveMarkers_Request, ...] = ...
    response: tuple[GetInteractiveMarkers_Response, ...] = ...

class GetInteractiveMarkers(Service[GetInteractiveMarkers_Request, GetInteractiveMarkers_Response]):
    Request: TypeAlias = GetInteractiveMarkers_Request
    Response: TypeAlias = GetInteractiveMarkers_Response
    Event: TypeAlias = GetInteractiveMarkers_Event
