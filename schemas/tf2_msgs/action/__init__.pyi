"""Actions of ROS 2 package tf2_msgs."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.builtin_interfaces import msg as builtin_interfaces
from cairn.schemas.geometry_msgs import msg as geometry_msgs
from cairn.schemas.message import Action, Service, message
from cairn.schemas.service_msgs import msg as service_msgs
from cairn.schemas.tf2_msgs import msg as tf2_msgs
from cairn.schemas.unique_identifier_msgs import msg as unique_identifier_msgs

@message("tf2_msgs/action/LookupTransform_Goal")
class LookupTransform_Goal:
    target_frame: field_types.String = ...
    source_frame: field_types.String = ...
    source_time: builtin_interfaces.Time = ...
    timeout: builtin_interfaces.Duration = ...
    target_time: builtin_interfaces.Time = ...
    fixed_frame: field_types.String = ...
    advanced: field_types.Bool = ...

@message("tf2_msgs/action/LookupTransform_Result")
class LookupTransform_Result:
    transform: geometry_msgs.TransformStamped = ...
    error: tf2_msgs.TF2Error = ...

@message("tf2_msgs/action/LookupTransform_Feedback")
class LookupTransform_Feedback:
    structure_needs_at_least_one_member: field_types.UInt8 = ...

@message("tf2_msgs/action/LookupTransform_SendGoal_Request")
class LookupTransform_SendGoal_Request:
    goal_id: unique_identifier_msgs.UUID = ...
    goal: LookupTransform_Goal = ...

@message("tf2_msgs/action/LookupTransform_SendGoal_Response")
class LookupTransform_SendGoal_Response:
    accepted: field_types.Bool = ...
    stamp: builtin_interfaces.Time = ...

@message("tf2_msgs/action/LookupTransform_SendGoal_Event")
class LookupTransform_SendGoal_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[LookupTransform_SendGoal_Request, ...] = ...
    response: tuple[LookupTransform_SendGoal_Response, ...] = ...

class LookupTransform_SendGoal(Service[LookupTransform_SendGoal_Request, LookupTransform_SendGoal_Response]):
    Request: TypeAlias = LookupTransform_SendGoal_Request
    Response: TypeAlias = LookupTransform_SendGoal_Response
    Event: TypeAlias = LookupTransform_SendGoal_Event

@message("tf2_msgs/action/LookupTransform_GetResult_Request")
class LookupTransform_GetResult_Request:
    goal_id: unique_identifier_msgs.UUID = ...

@message("tf2_msgs/action/LookupTransform_GetResult_Response")
class LookupTransform_GetResult_Response:
    status: field_types.Int8 = ...
    result: LookupTransform_Result = ...

@message("tf2_msgs/action/LookupTransform_GetResult_Event")
class LookupTransform_GetResult_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[LookupTransform_GetResult_Request, ...] = ...
    response: tuple[LookupTransform_GetResult_Response, ...] = ...

class LookupTransform_GetResult(Service[LookupTransform_GetResult_Request, LookupTransform_GetResult_Response]):
    Request: TypeAlias = LookupTransform_GetResult_Request
    Response: TypeAlias = LookupTransform_GetResult_Response
    Event: TypeAlias = LookupTransform_GetResult_Event

@message("tf2_msgs/action/LookupTransform_FeedbackMessage")
class LookupTransform_FeedbackMessage:
    goal_id: unique_identifier_msgs.UUID = ...
    feedback: LookupTransform_Feedback = ...

class LookupTransform(Action[LookupTransform_Goal, LookupTransform_Result, LookupTransform_Feedback]):
    Goal: TypeAlias = LookupTransform_Goal
    Result: TypeAlias = LookupTransform_Result
    Feedback: TypeAlias = LookupTransform_Feedback
    SendGoal: TypeAlias = LookupTransform_SendGoal
    GetResult: TypeAlias = LookupTransform_GetResult
    FeedbackMessage: TypeAlias = LookupTransform_FeedbackMessage
