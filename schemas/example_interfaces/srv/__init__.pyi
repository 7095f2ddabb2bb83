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

@message("example_interfaces/srv/SetBool_Request")
class SetBool_Request:
    data: field_types.Bool = ...

@message("example_interfaces/srv/SetBool_Response")
class SetBool_Response:
    success: field_types.Bool = ...
    message: field_types.String = ...

@message("example_interfaces/srv/SetBool_Event")
class SetBool_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SetBool_Request, ...] = ...
    response: tuple[SetBool_Response, ...] = ...

class SetBool(Service[SetBool_Request, SetBool_Response]):
    Request: TypeAlias = SetBool_Request
    Response: TypeAlias = SetBool_Response
    Event: TypeAlias = SetBool_Event

@message("example_interfaces/srv/Trigger_Request")
class Trigger_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("example_interfaces/srv/Trigger_Response")
class Trigger_Response:
    success: field_types.Bool = ...
    message: field_types.String = ...

@message("example_interfaces/srv/Trigger_Event")
class Trigger_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[Trigger_Request, ...] = ...
    response: tuple[Trigger_Response, ...] = ...

class Trigger(Service[Trigger_Request, Trigger_Response]):
    Request: TypeAlias = Trigger_Request
    Response: TypeAlias = Trigger_Response
    Event: TypeAlias = Trigger_Event
