"""Services of ROS 2 package sensor_msgs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.message import Service, message
from cairn.schemas.sensor_msgs import msg as sensor_msgs
from cairn.schemas.service_msgs import msg as service_msgs

@message("sensor_msgs/srv/SetCameraInfo_Request")
class SetCameraInfo_Request:
    camera_info: sensor_msgs.CameraInfo = ...

@message("sensor_msgs/srv/SetCameraInfo_Response")
class SetCameraInfo_Response:
    success: field_types.Bool = ...
    status_message: field_types.String = ...

@message("sensor_msgs/srv/SetCameraInfo_Event")
class SetCameraInfo_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[SetCameraInfo_Request, ...] = ...
    response: tuple[SetCameraInfo_Response, ...] = ...

class SetCameraInfo(Service[SetCameraInfo_Request, SetCameraInfo_Response]):
    Request: TypeAlias = SetCameraInfo_Request
    Response: TypeAlias = SetCameraInfo_Response
    Event: TypeAlias = SetCameraInfo_Event
