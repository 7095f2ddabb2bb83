"""Services of ROS 2 package example_interfaces."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.message import Service, message
from cairn.schemas.service_msgs import msg as service_msgs

@message("example_interfaces/srv/AddTwoInts_Request")
class AddTwoInts_Request:
    a: field_types.Int64 = ...
    b: field_types.Int64 = ...

@message("example_interfaces/srv/AddTwoInts_Response")
class AddTwoInts_Response:
    sum: field_types.Int64 = ...

@message("example_interfaces/srv/AddTwoInts_Event")
class AddTwoInts_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[AddTwoInts_Request, ...] = ...
    response: tuple[AddTwoInts_Response, ...] = ...

class AddTwoInts(Service[AddTwoInts_Request, AddTwoInts_Response]):
    Request: TypeAlias = AddTwoInts_Request
    Response: TypeAlias = AddTwoInts_Response
    Event: TypeAlias = AddTwoInts_Event
