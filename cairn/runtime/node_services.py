"""The services that every ROS 2 node has, for tools such as `ros2 param` and rqt.

They are open as long as the component exists, in every state, and answered between its handlers.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from cairn.bus.bus import Node, Publisher
from cairn.bus.qos import RELIABLE
from cairn.bus.type_hash import type_description, type_hash
from cairn.errors import CairnError
from cairn.runtime.loop import Scheduler
from cairn.runtime.parameters import ParameterDescription, ParameterRejected
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.definitions import DefinitionError
from cairn.schemas.interfaces import interface
from cairn.schemas.message import InvalidMessage, Service
from cairn.schemas.rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ListParametersResult,
    ParameterDescriptor,
    ParameterEvent,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from cairn.schemas.rcl_interfaces.msg import Parameter as RosParameter
from cairn.schemas.rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from cairn.schemas.type_description_interfaces.msg import (
    Field,
    FieldType,
    IndividualTypeDescription,
    TypeDescription,
)
from cairn.schemas.type_description_interfaces.srv import GetTypeDescription
from cairn.system.clock import Clock

PARAMETER_EVENTS: Final = "/parameter_events"
"""The topic on which every ROS 2 node publishes the changes of its parameters."""

USE_SIM_TIME: Final = "use_sim_time"
"""The parameter by which ROS 2 tools learn whether a node's time is simulated; it is read-only."""

NODE_SERVICES: Final = (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
    GetTypeDescription,
)
"""The services of every node."""

_EVENTS_QOS: Final = RELIABLE.with_depth(1000)  # as ROS 2 defines it
_MOST_NAMES: Final = 10_000


class NodeService(NamedTuple):
    """A service of a node: its name below that of the node, its type, and what answers a request.

    A `CairnError` refuses the call.
    """

    name: str
    service: type[Service[Any, Any]]
    answer: Callable[[Any], Any]


def serve_node(
    node: Node, name: str, scheduler: Scheduler, services: Sequence[NodeService]
) -> None:
    """Serve services below a node, of that full name, on a component's loop until `node` closes."""
    for one in services:
        service = _NodeServer(f"{name}/{one.name}", one)
        wake = partial(scheduler.deliver, service.receive)
        service.server = node.serve(service.name, one.service, wake, is_private=True)


class _NodeServer:
    def __init__(self, name: str, service: NodeService) -> None:
        self.name = name
        self._answer = service.answer
        self.server: Any = None

    def receive(self) -> None:
        if self.server is None:
            return
        try:
            call = self.server.take()
        except InvalidMessage:
            return  # the client has its answer
        if call is None:
            return
        try:
            call.reply(self._answer(call.request))
        except CairnError as error:
            call.refuse(f"{self.name}: {error}")
        except BaseException:
            call.refuse(f"{self.name}: its server failed; its log has the reason")
            raise


class ParameterServices:
    """The parameters of a component as ROS 2 knows them."""

    def __init__(
        self,
        node: Node,
        name: str,
        clock: Clock,
        described: Callable[[], list[ParameterDescription]],
        change: Callable[[Mapping[str, Any]], object],
        *,
        simulated_time: bool,
    ) -> None:
        """Serve the parameters of the component of that full name.

        `described` returns them as they are; `change` changes some of them, all or none, and raises
        `ParameterRejected`. `simulated_time` is the value of `use_sim_time`.
        """
        self._name = name
        self._clock = clock
        self._described = described
        self._change = change
        self._simulated_time = simulated_time
        self._events: Publisher = node.advertise(
            PARAMETER_EVENTS, ParameterEvent, _EVENTS_QOS, shared=True
        )

    def services(self) -> list[NodeService]:
        """Return the six services."""
        return [
            NodeService("describe_parameters", DescribeParameters, self._describe),
            NodeService("get_parameters", GetParameters, self._get),
            NodeService("get_parameter_types", GetParameterTypes, self._types),
            NodeService("list_parameters", ListParameters, self._list),
            NodeService("set_parameters", SetParameters, self._set),
            NodeService("set_parameters_atomically", SetParametersAtomically, self._set_atomically),
        ]

    def publish_change(self, names: Sequence[str]) -> None:
        """Publish that parameters have other values now."""
        if not self._events.has_subscribers:
            return
        known = self._known()
        changed = tuple(
            RosParameter(name=name, value=ros_value(known[name].value)) for name in names
        )
        self._events.publish(
            ParameterEvent(
                stamp=from_ns(self._clock.now()), node=self._name, changed_parameters=changed
            )
        )

    def _known(self) -> dict[str, ParameterDescription]:
        meaning = "Whether the time is that of topic clock."
        time = ParameterDescription(USE_SIM_TIME, self._simulated_time, "bool", meaning, "")
        return {one.name: one for one in [*self._described(), time]}

    def _get(self, request: GetParameters.Request) -> GetParameters.Response:
        known = self._known()
        values = (known.get(name) for name in _limited(request.names))
        return GetParameters.Response(
            values=tuple(
                ParameterValue() if one is None else ros_value(one.value) for one in values
            )
        )

    def _types(self, request: GetParameterTypes.Request) -> GetParameterTypes.Response:
        known = self._known()
        values = (known.get(name) for name in _limited(request.names))
        types = [0 if one is None else ros_value(one.value).type for one in values]
        return GetParameterTypes.Response(types=np.array(types, np.uint8))

    def _list(self, request: ListParameters.Request) -> ListParameters.Response:
        prefixes, depth = _limited(request.prefixes), request.depth

        def is_listed(name: str) -> bool:
            if not prefixes:
                return depth == 0 or name.count(".") < depth
            return any(
                name == prefix
                or (
                    name.startswith(f"{prefix}.")
                    and (depth == 0 or name[len(prefix) + 1 :].count(".") < depth)
                )
                for prefix in prefixes
            )

        names = tuple(name for name in self._known() if is_listed(name))
        groups = sorted({name.rpartition(".")[0] for name in names} - {""})
        return ListParameters.Response(
            result=ListParametersResult(names=names, prefixes=tuple(groups))
        )

    def _describe(self, request: DescribeParameters.Request) -> DescribeParameters.Response:
        known = self._known()
        return DescribeParameters.Response(
            descriptors=tuple(
                _descriptor(known[name]) if name in known else ParameterDescriptor(name=name)
                for name in _limited(request.names)
            )
        )

    def _set(self, request: SetParameters.Request) -> SetParameters.Response:
        results = [self._changed([one]) for one in request.parameters[:_MOST_NAMES]]
        return SetParameters.Response(results=tuple(results))

    def _set_atomically(
        self, request: SetParametersAtomically.Request
    ) -> SetParametersAtomically.Response:
        return SetParametersAtomically.Response(result=self._changed(request.parameters))

    def _changed(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        try:
            changes = {}
            for one in parameters:
                if one.name == USE_SIM_TIME:
                    raise ParameterRejected(
                        f"parameter {USE_SIM_TIME} is read-only: `clock` of the deployment sets it"
                    )
                changes[one.name] = python_value(one)
            self._change(changes)
        except CairnError as error:
            return SetParametersResult(successful=False, reason=str(error)[:4000])
        return SetParametersResult(successful=True)


def describe_type(request: GetTypeDescription.Request) -> GetTypeDescription.Response:
    """Answer a request for the description of a type."""
    try:
        described = interface(request.type_name)
    except DefinitionError as error:
        return GetTypeDescription.Response(successful=False, failure_reason=str(error))
    if request.type_hash not in ("", type_hash(described)):
        reason = f"{request.type_name} has the hash {type_hash(described)} here"
        return GetTypeDescription.Response(successful=False, failure_reason=reason)
    message = type_description(described)["type_description_msg"]
    return GetTypeDescription.Response(
        successful=True,
        type_description=_description_message(message),
    )


def _description_message(described: Mapping[str, Any]) -> TypeDescription:
    def individual(one: Mapping[str, Any]) -> IndividualTypeDescription:
        return IndividualTypeDescription(
            type_name=one["type_name"],
            fields=tuple(
                Field(name=field["name"], type=FieldType(**field["type"]))
                for field in one["fields"]
            ),
        )

    return TypeDescription(
        type_description=individual(described["type_description"]),
        referenced_type_descriptions=tuple(
            map(individual, described["referenced_type_descriptions"])
        ),
    )


_VALUE_FIELDS: Final = (
    "bool_value", "integer_value", "double_value", "string_value", "byte_array_value",
    "bool_array_value", "integer_array_value", "double_array_value", "string_array_value",
)  # fmt: skip
"""The fields of `ParameterValue` with the values of the types 1 to 9 of `ParameterType`."""


def ros_value(value: Any) -> ParameterValue:
    """Return a parameter's value as ROS 2 has it; what it has no type for, as JSON in a string."""
    if value is None:
        return ParameterValue()
    if isinstance(value, bool):
        return _of_type(ParameterType.PARAMETER_BOOL, value)
    if isinstance(value, int):
        return _of_type(ParameterType.PARAMETER_INTEGER, value)
    if isinstance(value, float):
        return _of_type(ParameterType.PARAMETER_DOUBLE, value)
    if isinstance(value, list | tuple) and value:
        kinds = {type(one) for one in value}
        if kinds == {bool}:
            return _of_type(ParameterType.PARAMETER_BOOL_ARRAY, np.array(value, np.bool_))
        if kinds == {int}:
            return _of_type(ParameterType.PARAMETER_INTEGER_ARRAY, np.array(value, np.int64))
        if kinds <= {int, float}:
            return _of_type(ParameterType.PARAMETER_DOUBLE_ARRAY, np.array(value, np.float64))
        if all(isinstance(one, str) for one in value):
            return _of_type(ParameterType.PARAMETER_STRING_ARRAY, tuple(value))
    if isinstance(value, list | tuple | dict):
        value = json.dumps(value, default=str)
    return _of_type(ParameterType.PARAMETER_STRING, str(value))


def _of_type(kind: int, value: Any) -> ParameterValue:
    return ParameterValue(type=kind, **{_VALUE_FIELDS[kind - 1]: value})


def python_value(parameter: RosParameter) -> Any:
    """Return the value of a ROS 2 parameter; raises `ParameterRejected` for an unknown type."""
    kind = parameter.value.type
    if kind == ParameterType.PARAMETER_NOT_SET:
        return None
    if kind > len(_VALUE_FIELDS):
        raise ParameterRejected(
            f"parameter {parameter.name}: there is no parameter type {kind} (0 to 9)"
        )
    value = getattr(parameter.value, _VALUE_FIELDS[kind - 1])
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _descriptor(parameter: ParameterDescription) -> ParameterDescriptor:
    value = ros_value(parameter.value)
    low, high = parameter.range
    is_limited = (low, high) != (None, None)
    integer: tuple[IntegerRange, ...] = ()
    floating: tuple[FloatingPointRange, ...] = ()
    if is_limited and value.type == ParameterType.PARAMETER_INTEGER:
        least = -(2**63) if low is None else int(low)
        most = 2**63 - 1 if high is None else int(high)
        integer = (IntegerRange(from_value=least, to_value=most, step=1),)
    elif is_limited and value.type == ParameterType.PARAMETER_DOUBLE:
        lowest = float("-inf") if low is None else low
        highest = float("inf") if high is None else high
        floating = (FloatingPointRange(from_value=lowest, to_value=highest),)
    return ParameterDescriptor(
        name=parameter.name,
        type=value.type,
        description=parameter.description,
        additional_constraints=parameter.bounds,
        read_only=parameter.name == USE_SIM_TIME,
        integer_range=integer,
        floating_point_range=floating,
    )


def _limited(names: Sequence[str]) -> Sequence[str]:
    if len(names) > _MOST_NAMES:
        raise CairnError(f"{len(names)} names; ask for at most {_MOST_NAMES} at a time")
    return names
