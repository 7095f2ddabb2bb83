"""Actions of ROS 2 package example_interfaces."""

from typing import TypeAlias

from cairn.schemas import field_types
from cairn.schemas.builtin_interfaces import msg as builtin_interfaces
from cairn.schemas.message import Action, Service, message
from cairn.schemas.service_msgs import msg as service_msgs
from cairn.schemas.unique_identifier_msgs import msg as unique_identifier_msgs

@message("example_interfaces/action/Fibonacci_Goal")
class Fibonacci_Goal:
    order: field_types.Int32 = ...

@message("example_interfaces/action/Fibonacci_Result")
class Fibonacci_Result:
    sequence: field_types.Int32Array = ...

@message("example_interfaces/action/Fibonacci_Feedback")
class Fibonacci_Feedback:
    sequence: field_types.Int32Array = ...

@message("example_interfaces/action/Fibonacci_SendGoal_Request")
class Fibonacci_SendGoal_Request:
    goal_id: unique_identifier_msgs.UUID = ...
    goal: Fibonacci_Goal = ...

@message("example_interfaces/action/Fibonacci_SendGoal_Response")
class Fibonacci_SendGoal_Response:
    accepted: field_types.Bool = ...
    stamp: builtin_interfaces.Time = ...

@message("example_interfaces/action/Fibonacci_SendGoal_Event")
class Fibonacci_SendGoal_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[Fibonacci_SendGoal_Request, ...] = ...
    response: tuple[Fibonacci_SendGoal_Response, ...] = ...

class Fibonacci_SendGoal(Service[Fibonacci_SendGoal_Request, Fibonacci_SendGoal_Response]):
    Request: TypeAlias = Fibonacci_SendGoal_Request
    Response: TypeAlias = Fibonacci_SendGoal_Response
    Event: TypeAlias = Fibonacci_SendGoal_Event

@message("example_interfaces/action/Fibonacci_GetResult_Request")
class Fibonacci_GetResult_Request:
    goal_id: unique_identifier_msgs.UUID = ...

@message("example_interfaces/action/Fibonacci_GetResult_Response")
class Fibonacci_GetResult_Response:
    status: field_types.Int8 = ...
    result: Fibonacci_Result = ...

@message("example_interfaces/action/Fibonacci_GetResult_Event")
class Fibonacci_GetResult_Event:
    info: service_msgs.ServiceEventInfo = ...
    request: tuple[Fibonacci_GetResult_Request, ...] = ...
    response: tuple[Fibonacci_GetResult_Response, ...] = ...

class Fibonacci_GetResult(Service[Fibonacci_GetResult_Request, Fibonacci_GetResult_Response]):
    Request: TypeAlias = Fibonacci_GetResult_Request
    Response: TypeAlias = Fibonacci_GetResult_Response
    Event: TypeAlias = Fibonacci_GetResult_Event

@message("example_interfaces/action/Fibonacci_FeedbackMessage")
class Fibonacci_FeedbackMessage:
    goal_id: unique_identifier_msgs.UUID = ...
    feedback: Fibonacci_Feedback = ...

class Fibonacci(Action[Fibonacci_Goal, Fibonacci_Result, Fibonacci_Feedback]):
    Goal: TypeAlias = Fibonacci_Goal
    Result: TypeAlias = Fibonacci_Result
    Feedback: TypeAlias = Fibonacci_Feedback
    SendGoal: TypeAlias = Fibonacci_SendGoal
    GetResult: TypeAlias = Fibonacci_GetResult
    FeedbackMessage: TypeAlias = Fibonacci_FeedbackMessage
