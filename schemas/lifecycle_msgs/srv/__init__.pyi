"""Services of ROS 2 package lifecycle_msgs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.lifecycle_msgs import msg as lifecycle_msgs
from cairn.schemas.message import Service, message
from cairn.schemas.service_msgs import msg as service_msgs

@message("lifecycle_msgs/srv/ChangeState_Request")
class ChangeState_Request:
    transition: lifecycle_msgs.Transition = ...

@message("lifecycle_msgs/srv/ChangeState_Response")
class ChangeState_Response:
    success: field_types.Bool = ...

@message("lifecycle_msgs/srv/ChangeState_Event")
class ChangeState_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[ChangeState_Request, ...] = ...
    response: tuple[ChangeState_Response, ...] = ...

class ChangeState(Service[ChangeState_Request, ChangeState_Response]):
    Request: TypeAlias = ChangeState_Request
    Response: TypeAlias = ChangeState_Response
    Event: TypeAlias = ChangeState_Event

@message("lifecycle_msgs/srv/GetAvailableStates_Request")
class GetAvailableStates_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("lifecycle_msgs/srv/GetAvailableStates_Response")
class GetAvailableStates_Response:
    available_states: tuple[lifecycle_msgs.State, ...] = ...

@message("lifecycle_msgs/srv/GetAvailableStates_Event")
class GetAvailableStates_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetAvailableStates_Request, ...] = ...
    response: tuple[GetAvailableStates_Response, ...] = ...

class GetAvailableStates(Service[GetAvailableStates_Request, GetAvailableStates_Response]):
    Request: TypeAlias = GetAvailableStates_Request
    Response: TypeAlias = GetAvailableStates_Response
    Event: TypeAlias = GetAvailableStates_Event

@message("lifecycle_msgs/srv/GetAvailableTransitions_Request")
class GetAvailableTransitions_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("lifecycle_msgs/srv/GetAvailableTransitions_Response")
class GetAvailableTransitions_Response:
    available_transitions: tuple[lifecycle_msgs.TransitionDescription, ...] = ...

@message("lifecycle_msgs/srv/GetAvailableTransitions_Event")
class GetAvailableTransitions_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetAvailableTransitions_Request, ...] = ...
    response: tuple[GetAvailableTransitions_Response, ...] = ...

class GetAvailableTransitions(Service[GetAvailableTransitions_Request, GetAvailableTransitions_Response]):
    Request: TypeAlias = GetAvailableTransitions_Request
    Response: TypeAlias = GetAvailableTransitions_Response
    Event: TypeAlias = GetAvailableTransitions_Event

@message("lifecycle_msgs/srv/GetState_Request")
class GetState_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("lifecycle_msgs/srv/GetState_Response")
class GetState_Response:
    current_state: lifecycle_msgs.State = ...

@message("lifecycle_msgs/srv/GetState_Event")
class GetState_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetState_Request, ...] = ...
    response: tuple[GetState_Response, ...] = ...

class GetState(Service[GetState_Request, GetState_Response]):
    Request: TypeAlias = GetState_Request
    Response: TypeAlias = GetState_Response
    Event: TypeAlias = GetState_Event
