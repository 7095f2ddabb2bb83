"""Services of ROS 2 package diagnostic_msgs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.diagnostic_msgs import msg as diagnostic_msgs
from cairn.schemas.message import Service, message
from cairn.schemas.service_msgs import msg as service_msgs

@message("diagnostic_msgs/srv/AddDiagnostics_Request")
class AddDiagnostics_Request:
    load_namespace: field_types.String = ...

@message("diagnostic_msgs/srv/AddDiagnostics_Response")
class AddDiagnostics_Response:
    success: field_types.Bool = ...
    message: field_types.String = ...

@message("diagnostic_msgs/srv/AddDiagnostics_Event")
class AddDiagnostics_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[AddDiagnostics_Request, ...] = ...
    response: tuple[AddDiagnostics_Response, ...] = ...

class AddDiagnostics(Service[AddDiagnostics_Request, AddDiagnostics_Response]):
    Request: TypeAlias = AddDiagnostics_Request
    Response: TypeAlias = AddDiagnostics_Response
    Event: TypeAlias = AddDiagnostics_Event

@message("diagnostic_msgs/srv/SelfTest_Request")
class SelfTest_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("diagnostic_msgs/srv/SelfTest_Response")
class SelfTest_Response:
    id: field_types.String = ...
    passed: field_types.Byte = ...
    status: tuple[diagnostic_msgs.DiagnosticStatus, ...] = ...

@message("diagnostic_msgs/srv/SelfTest_Event")
class SelfTest_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SelfTest_Request, ...] = ...
    response: tuple[SelfTest_Response, ...] = ...

class SelfTest(Service[SelfTest_Request, SelfTest_Response]):
    Request: TypeAlias = SelfTest_Request
    Response: TypeAlias = SelfTest_Response
    Event: TypeAlias = SelfTest_Event
