"""Services of ROS 2 package std_srvs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.message import Service, message
from cairn.schemas.service_msgs import msg as service_msgs

@message("std_srvs/srv/Empty_Request")
class Empty_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("std_srvs/srv/Empty_Response")
class Empty_Response:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("std_srvs/srv/Empty_Event")
class Empty_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[Empty_Request, ...] = ...
    response: tuple[Empty_Response, ...] = ...

class Empty(Service[Empty_Request, Empty_Response]):
    Request: TypeAlias = Empty_Request
    Response: TypeAlias = Empty_Response
    Event: TypeAlias = Empty_Event

@message("std_srvs/srv/SetBool_Request")
class SetBool_Request:
    data: field_types.Bool = ...

@message("std_srvs/srv/SetBool_Response")
class SetBool_Response:
    success: field_types.Bool = ...
    message: field_types.String = ...

@message("std_srvs/srv/SetBool_Event")
class SetBool_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SetBool_Request, ...] = ...
    response: tuple[SetBool_Response, ...] = ...

class SetBool(Service[SetBool_Request, SetBool_Response]):
    Request: TypeAlias = SetBool_Request
    Response: TypeAlias = SetBool_Response
    Event: TypeAlias = SetBool_Event

@message("std_srvs/srv/Trigger_Request")
class Trigger_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("std_srvs/srv/Trigger_Response")
class Trigger_Response:
    success: field_types.Bool = ...
    message: field_types.String = ...

@message("std_srvs/srv/Trigger_Event")
class Trigger_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[Trigger_Request, ...] = ...
    response: tuple[Trigger_Response, ...] = ...

class Trigger(Service[Trigger_Request, Trigger_Response]):
    Request: TypeAlias = Trigger_Request
    Response: TypeAlias = Trigger_Response
    Event: TypeAlias = Trigger_Event
