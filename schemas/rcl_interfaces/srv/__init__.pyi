"""Services of ROS 2 package rcl_interfaces."""

from typing import ClassVar, TypeAlias

from cairn.schemas import field_types
from cairn.schemas.message import Service, message
from cairn.schemas.rcl_interfaces import msg as rcl_interfaces
from cairn.schemas.service_msgs import msg as service_msgs

@message("rcl_interfaces/srv/DescribeParameters_Request")
class DescribeParameters_Request:
    names: tuple[field_types.String, ...] = ...

@message("rcl_interfaces/srv/DescribeParameters_Response")
class DescribeParameters_Response:
    descriptors: tuple[rcl_interfaces.ParameterDescriptor, ...] = ...

@message("rcl_interfaces/srv/DescribeParameters_Event")
class DescribeParameters_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[DescribeParameters_Request, ...] = ...
    response: tuple[DescribeParameters_Response, ...] = ...

class DescribeParameters(Service[DescribeParameters_Request, DescribeParameters_Response]):
    Request: TypeAlias = DescribeParameters_Request
    Response: TypeAlias = DescribeParameters_Response
    Event: TypeAlias = DescribeParameters_Event

@message("rcl_interfaces/srv/GetLoggerLevels_Request")
class GetLoggerLevels_Request:
    names: tuple[field_types.String, ...] = ...

@message("rcl_interfaces/srv/GetLoggerLevels_Response")
class GetLoggerLevels_Response:
    levels: tuple[rcl_interfaces.LoggerLevel, ...] = ...

@message("rcl_interfaces/srv/GetLoggerLevels_Event")
class GetLoggerLevels_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetLoggerLevels_Request, ...] = ...
    response: tuple[GetLoggerLevels_Response, ...] = ...

class GetLoggerLevels(Service[GetLoggerLevels_Request, GetLoggerLevels_Response]):
    Request: TypeAlias = GetLoggerLevels_Request
    Response: TypeAlias = GetLoggerLevels_Response
    Event: TypeAlias = GetLoggerLevels_Event

@message("rcl_interfaces/srv/GetParameterTypes_Request")
class GetParameterTypes_Request:
    names: tuple[field_types.String, ...] = ...

@message("rcl_interfaces/srv/GetParameterTypes_Response")
class GetParameterTypes_Response:
    types: field_types.UInt8Array = ...

@message("rcl_interfaces/srv/GetParameterTypes_Event")
class GetParameterTypes_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetParameterTypes_Request, ...] = ...
    response: tuple[GetParameterTypes_Response, ...] = ...

class GetParameterTypes(Service[GetParameterTypes_Request, GetParameterTypes_Response]):
    Request: TypeAlias = GetParameterTypes_Request
    Response: TypeAlias = GetParameterTypes_Response
    Event: TypeAlias = GetParameterTypes_Event

@message("rcl_interfaces/srv/GetParameters_Request")
class GetParameters_Request:
    names: tuple[field_types.String, ...] = ...

@message("rcl_interfaces/srv/GetParameters_Response")
class GetParameters_Response:
    values: tuple[rcl_interfaces.ParameterValue, ...] = ...

@message("rcl_interfaces/srv/GetParameters_Event")
class GetParameters_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetParameters_Request, ...] = ...
    response: tuple[GetParameters_Response, ...] = ...

class GetParameters(Service[GetParameters_Request, GetParameters_Response]):
    Request: TypeAlias = GetParameters_Request
    Response: TypeAlias = GetParameters_Response
    Event: TypeAlias = GetParameters_Event

@message("rcl_interfaces/srv/ListParameters_Request")
class ListParameters_Request:
    DEPTH_RECURSIVE: ClassVar[field_types.UInt64] = ...
    prefixes: tuple[field_types.String, ...] = ...
    depth: field_types.UInt64 = ...

@message("rcl_interfaces/srv/ListParameters_Response")
class ListParameters_Response:
    result: rcl_interfaces.ListParametersResult = ...

@message("rcl_interfaces/srv/ListParameters_Event")
class ListParameters_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[ListParameters_Request, ...] = ...
    response: tuple[ListParameters_Response, ...] = ...

class ListParameters(Service[ListParameters_Request, ListParameters_Response]):
    Request: TypeAlias = ListParameters_Request
    Response: TypeAlias = ListParameters_Response
    Event: TypeAlias = ListParameters_Event

@message("rcl_interfaces/srv/SetLoggerLevels_Request")
class SetLoggerLevels_Request:
    levels: tuple[rcl_interfaces.LoggerLevel, ...] = ...

@message("rcl_interfaces/srv/SetLoggerLevels_Response")
class SetLoggerLevels_Response:
    results: tuple[rcl_interfaces.SetLoggerLevelsResult, ...] = ...

@message("rcl_interfaces/srv/SetLoggerLevels_Event")
class SetLoggerLevels_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SetLoggerLevels_Request, ...] = ...
    response: tuple[SetLoggerLevels_Response, ...] = ...

class SetLoggerLevels(Service[SetLoggerLevels_Request, SetLoggerLevels_Response]):
    Request: TypeAlias = SetLoggerLevels_Request
    Response: TypeAlias = SetLoggerLevels_Response
    Event: TypeAlias = SetLoggerLevels_Event

@message("rcl_interfaces/srv/SetParameters_Request")
class SetParameters_Request:
    parameters: tuple[rcl_interfaces.Parameter, ...] = ...

@message("rcl_interfaces/srv/SetParameters_Response")
class SetParameters_Response:
    results: tuple[rcl_interfaces.SetParametersResult, ...] = ...

@message("rcl_interfaces/srv/SetParameters_Event")
class SetParameters_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SetParameters_Request, ...] = ...
    response: tuple[SetParameters_Response, ...] = ...

class SetParameters(Service[SetParameters_Request, SetParameters_Response]):
    Request: TypeAlias = SetParameters_Request
    Response: TypeAlias = SetParameters_Response
    Event: TypeAlias = SetParameters_Event

@message("rcl_interfaces/srv/SetParametersAtomically_Request")
class SetParametersAtomically_Request:
    parameters: tuple[rcl_interfaces.Parameter, ...] = ...

@message("rcl_interfaces/srv/SetParametersAtomically_Response")
class SetParametersAtomically_Response:
    result: rcl_interfaces.SetParametersResult = ...

@message("rcl_interfaces/srv/SetParametersAtomically_Event")
class SetParametersAtomically_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SetParametersAtomically_Request, ...] = ...
    response: tuple[SetParametersAtomically_Response, ...] = ...

class SetParametersAtomically(Service[SetParametersAtomically_Request, SetParametersAtomically_Response]):
    Request: TypeAlias = SetParametersAtomically_Request
    Response: TypeAlias = SetParametersAtomically_Response
    Event: TypeAlias = SetParametersAtomically_Event
