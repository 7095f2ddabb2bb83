"""Services of ROS 2 package map_msgs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.map_msgs import msg as map_msgs
from cairn.schemas.message import Service, message
from cairn.schemas.nav_msgs import msg as nav_msgs
from cairn.schemas.sensor_msgs import msg as sensor_msgs
from cairn.schemas.service_msgs import msg as service_msgs
from cairn.schemas.std_msgs import msg as std_msgs

@message("map_msgs/srv/GetMapROI_Request")
class GetMapROI_Request:
    x: field_types.Float64 = ...
    y: field_types.Float64 = ...
    l_x: field_types.Float64 = ...
    l_y: field_types.Float64 = ...

@message("map_msgs/srv/GetMapROI_Response")
class GetMapROI_Response:
    sub_map: nav_msgs.OccupancyGrid = ...

@message("map_msgs/srv/GetMapROI_Event")
class GetMapROI_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetMapROI_Request, ...] = ...
    response: tuple[GetMapROI_Response, ...] = ...

class GetMapROI(Service[GetMapROI_Request, GetMapROI_Response]):
    Request: TypeAlias = GetMapROI_Request
    Response: TypeAlias = GetMapROI_Response
    Event: TypeAlias = GetMapROI_Event

@message("map_msgs/srv/GetPointMap_Request")
class GetPointMap_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("map_msgs/srv/GetPointMap_Response")
class GetPointMap_Response:
    map: sensor_msgs.PointCloud2 = ...

@message("map_msgs/srv/GetPointMap_Event")
class GetPointMap_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetPointMap_Request, ...] = ...
    response: tuple[GetPointMap_Response, ...] = ...

class GetPointMap(Service[GetPointMap_Request, GetPointMap_Response]):
    Request: TypeAlias = GetPointMap_Request
    Response: TypeAlias = GetPointMap_Response
    Event: TypeAlias = GetPointMap_Event

@message("map_msgs/srv/GetPointMapROI_Request")
class GetPointMapROI_Request:
    x: field_types.Float64 = ...
    y: field_types.Float64 = ...
    z: field_types.Float64 = ...
    r: field_types.Float64 = ...
    l_x: field_types.Float64 = ...
    l_y: field_types.Float64 = ...
    l_z: field_types.Float64 = ...

@message("map_msgs/srv/GetPointMapROI_Response")
class GetPointMapROI_Response:
    sub_map: sensor_msgs.PointCloud2 = ...

@message("map_msgs/srv/GetPointMapROI_Event")
class GetPointMapROI_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[GetPointMapROI_Request, ...] = ...
    response: tuple[GetPointMapROI_Response, ...] = ...

class GetPointMapROI(Service[GetPointMapROI_Request, GetPointMapROI_Response]):
    Request: TypeAlias = GetPointMapROI_Request
    Response: TypeAlias = GetPointMapROI_Response
    Event: TypeAlias = GetPointMapROI_Event

@message("map_msgs/srv/ProjectedMapsInfo_Request")
class ProjectedMapsInfo_Request:
    projected_maps_info: tuple[map_msgs.ProjectedMapInfo, ...] = ...

@message("map_msgs/srv/ProjectedMapsInfo_Response")
class ProjectedMapsInfo_Response:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("map_msgs/srv/ProjectedMapsInfo_Event")
class ProjectedMapsInfo_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[ProjectedMapsInfo_Request, ...] = ...
    response: tuple[ProjectedMapsInfo_Response, ...] = ...

class ProjectedMapsInfo(Service[ProjectedMapsInfo_Request, ProjectedMapsInfo_Response]):
    Request: TypeAlias = ProjectedMapsInfo_Request
    Response: TypeAlias = ProjectedMapsInfo_Response
    Event: TypeAlias = ProjectedMapsInfo_Event

@message("map_msgs/srv/SaveMap_Request")
class SaveMap_Request:
    filename: std_msgs.String = ...

@message("map_msgs/srv/SaveMap_Response")
class SaveMap_Response:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("map_msgs/srv/SaveMap_Event")
class SaveMap_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SaveMap_Request, ...] = ...
    response: tuple[SaveMap_Response, ...] = ...

class SaveMap(Service[SaveMap_Request, SaveMap_Response]):
    Request: TypeAlias = SaveMap_Request
    Response: TypeAlias = SaveMap_Response
    Event: TypeAlias = SaveMap_Event

@message("map_msgs/srv/SetMapProjections_Request")
class SetMapProjections_Request:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("map_msgs/srv/SetMapProjections_Response")
class SetMapProjections_Response:
    projected_maps_info: tuple[map_msgs.ProjectedMapInfo, ...] = ...

@message("map_msgs/srv/SetMapProjections_Event")
class SetMapProjections_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SetMapProjections_Request, ...] = ...
    response: tuple[SetMapProjections_Response, ...] = ...

class SetMapProjections(Service[SetMapProjections_Request, SetMapProjections_Response]):
    Request: TypeAlias = SetMapProjections_Request
    Response: TypeAlias = SetMapProjections_Response
    Event: TypeAlias = SetMapProjections_Event
