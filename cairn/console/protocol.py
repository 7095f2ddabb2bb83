"""The messages between console and browser: `foxglove.websocket.v1` and what the console adds.

The specification is https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md; what the
console adds is in docs/reference/console-protocol.md.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping, Set
from typing import Annotated, Any, Final, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.alias_generators import to_camel

from cairn.console.source import Channel, ConnectionGraph
from cairn.limits.json import parse_json

CONSOLE: Final = "cairn.console.v1"
SUBPROTOCOLS: Final = (CONSOLE, "foxglove.websocket.v1", "foxglove.sdk.v1")

LONGEST_TEXT: Final = 256 << 10
"""Longest JSON message of a browser [bytes]."""

LONGEST_FRAME: Final = 4 << 20
"""Longest message of a browser [bytes]: CDR that it publishes."""

INFO, WARNING, ERROR = 0, 1, 2
"""Levels of `status`."""

_MESSAGE_DATA: Final = struct.Struct("<BIQ")
_TIME: Final = struct.Struct("<BQ")
_SERVICE: Final = struct.Struct("<BIII")
_ASSET: Final = struct.Struct("<BIBI")
_JPEG: Final = struct.Struct("<II")
_CHANNEL: Final = struct.Struct("<BI")

Id = Annotated[int, Field(ge=0, lt=1 << 32)]
Name = Annotated[str, Field(max_length=1000)]
Names = Annotated[list[Name], Field(max_length=1000)]


class ProtocolError(Exception):
    """A message of a browser that is not valid."""


class _Message(BaseModel):
    """Its fields are in camel case on the wire. Unknown ones are ignored: of a newer client."""

    model_config = ConfigDict(
        extra="ignore", frozen=True, strict=True, alias_generator=to_camel, populate_by_name=True
    )


class SubscribeRequest(_Message):
    """One subscription: `max_hz` limits its rate, `jpeg` asks for images as JPEG."""

    id: Id
    channel_id: Id
    max_hz: Annotated[float, Field(gt=0, le=1000)] | None = None
    jpeg: bool = False


class Subscribe(_Message):
    """Subscribe to channels."""

    op: Literal["subscribe"]
    subscriptions: Annotated[list[SubscribeRequest], Field(max_length=1000)]


class Unsubscribe(_Message):
    """End subscriptions."""

    op: Literal["unsubscribe"]
    subscription_ids: Annotated[list[Id], Field(max_length=1000)]


class ClientChannel(_Message):
    """A channel on which a browser publishes."""

    id: Id
    topic: Name
    encoding: Name
    schema_name: Name


class Advertise(_Message):
    """Announce channels on which the browser publishes."""

    op: Literal["advertise"]
    channels: Annotated[list[ClientChannel], Field(max_length=100)]


class Unadvertise(_Message):
    """Withdraw channels of the browser."""

    op: Literal["unadvertise"]
    channel_ids: Annotated[list[Id], Field(max_length=100)]


class GetParameters(_Message):
    """Read parameters; all if no name is given."""

    op: Literal["getParameters"]
    parameter_names: Names
    id: Name | None = None


class ParameterValue(_Message):
    """A parameter and its new value."""

    name: Name
    value: Any = None
    type: Name | None = None


class SetParameters(_Message):
    """Change parameters."""

    op: Literal["setParameters"]
    parameters: Annotated[list[ParameterValue], Field(max_length=1000)]
    id: Name | None = None


class SubscribeParameters(_Message):
    """Receive changes of parameters; of all if no name is given."""

    op: Literal["subscribeParameterUpdates"]
    parameter_names: Names


class UnsubscribeParameters(_Message):
    """Receive changes of these parameters no longer; of none if no name is given."""

    op: Literal["unsubscribeParameterUpdates"]
    parameter_names: Names


class SubscribeGraph(_Message):
    """Receive the connection graph and its changes."""

    op: Literal["subscribeConnectionGraph"]


class UnsubscribeGraph(_Message):
    """Receive the connection graph no longer."""

    op: Literal["unsubscribeConnectionGraph"]


class FetchAsset(_Message):
    """Ask for a file, of which there is none."""

    op: Literal["fetchAsset"]
    uri: Name
    request_id: Id


class CallMethod(_Message):
    """Call a method (console only)."""

    op: Literal["call"]
    id: Id
    method: Name
    arguments: dict[str, Any] = {}


Request = (
    Subscribe
    | Unsubscribe
    | Advertise
    | Unadvertise
    | GetParameters
    | SetParameters
    | SubscribeParameters
    | UnsubscribeParameters
    | SubscribeGraph
    | UnsubscribeGraph
    | FetchAsset
    | CallMethod
)
_requests: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="op")])


class ClientData(NamedTuple):
    """A message that a browser publishes on one of its channels."""

    channel: int
    payload: bytes


class ServiceCall(NamedTuple):
    """A call of a service."""

    service: int
    call: int
    encoding: str
    payload: bytes


def parse_text(text: str) -> Request:
    """Return a browser's JSON message; `ProtocolError` if it is not valid."""
    try:
        return _requests.validate_python(parse_json(text.encode(), LONGEST_TEXT))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise ProtocolError(f"invalid message: {where or 'op'}: {first['msg']}"[:500]) from None
    except ValueError as error:
        raise ProtocolError(f"a text message must be a JSON object: {error}"[:500]) from None


def parse_binary(data: bytes) -> ClientData | ServiceCall:
    """Return a browser's binary message; `ProtocolError` if it is not valid."""
    if data[:1] == b"\x01" and len(data) >= _CHANNEL.size:
        return ClientData(_CHANNEL.unpack_from(data)[1], data[_CHANNEL.size :])
    if data[:1] == b"\x02" and len(data) >= _SERVICE.size:
        _, service, call, length = _SERVICE.unpack_from(data)
        payload = _SERVICE.size + length
        encoding = data[_SERVICE.size : payload]
        if length > 100 or len(encoding) != length or not encoding.isascii():
            raise ProtocolError("invalid service call: the length of its encoding is wrong")
        return ServiceCall(service, call, encoding.decode(), data[payload:])
    raise ProtocolError(
        f"invalid binary message of {len(data)} bytes with opcode {data[:1].hex() or 'none'}; "
        "opcodes are 01 (message data) and 02 (service call)"
    )


def message_data(subscription: int, time_ns: int, payload: bytes) -> bytes:
    """Return the binary message that carries a message of a topic."""
    return _MESSAGE_DATA.pack(1, subscription, max(0, time_ns)) + payload


def time_data(time_ns: int) -> bytes:
    """Return the binary message that carries the time of a recording that is played."""
    return _TIME.pack(2, time_ns)


def service_response(call: ServiceCall, payload: bytes) -> bytes:
    """Return the binary answer to a service call."""
    encoding = call.encoding.encode()
    head = _SERVICE.pack(3, call.service, call.call, len(encoding))
    return head + encoding + payload


def asset_refusal(request: int, reason: str) -> bytes:
    """Return the binary answer that there is no such asset."""
    text = reason.encode()
    return _ASSET.pack(4, request, 1, len(text)) + text


def jpeg_payload(width: int, height: int, jpeg: bytes) -> bytes:
    """Return the payload of an image as JPEG."""
    return _JPEG.pack(width, height) + jpeg


def to_text(message: dict[str, Any]) -> str:
    """Return a JSON message; `ValueError` if it contains what JSON does not have, such as NaN."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def event(name: str, value: Any) -> str:
    """Return an event, as JSON (console only)."""
    return to_text({"op": "event", "name": name, "value": value})


def advertise(channels: Iterable[Channel]) -> dict[str, Any]:
    """Return the message that describes new channels."""
    described = [
        {
            "id": channel.id,
            "topic": channel.topic,
            "encoding": "cdr",
            "schemaName": channel.type_name,
            "schemaEncoding": "ros2msg",
            "schema": channel.schema,
        }
        for channel in channels
    ]
    return {"op": "advertise", "channels": described}


def parameter_values(values: Mapping[str, Any], id_: str | None = None) -> dict[str, Any]:
    """Return the message with values of parameters, as the answer to the request `id_`."""
    parameters = [
        {"name": name, "value": value, **_type_of(value)}
        for name, value in values.items()
        if value is not None
    ]
    message = {"op": "parameterValues", "parameters": parameters}
    return message if id_ is None else {**message, "id": id_}


def _type_of(value: Any) -> dict[str, str]:
    """Return the type of a parameter, where JSON does not show it: 1.0 is the same as 1 there."""
    if isinstance(value, float):
        return {"type": "float64"}
    if isinstance(value, list) and value and all(isinstance(one, float) for one in value):
        return {"type": "float64_array"}
    return {}


NO_GRAPH_CHANGE: Final[Mapping[str, Any]] = {
    "op": "connectionGraphUpdate",
    "publishedTopics": [],
    "subscribedTopics": [],
    "advertisedServices": [],
    "removedTopics": [],
    "removedServices": [],
}


def graph_change(before: ConnectionGraph, after: ConnectionGraph) -> dict[str, Any]:
    """Return the message about what has changed; `NO_GRAPH_CHANGE` if nothing has."""
    topics = {*after.publishers, *after.subscribers}
    return {
        **NO_GRAPH_CHANGE,
        "publishedTopics": _changed(before.publishers, after.publishers, "publisherIds"),
        "subscribedTopics": _changed(before.subscribers, after.subscribers, "subscriberIds"),
        "removedTopics": sorted({*before.publishers, *before.subscribers} - topics),
    }


def _changed(
    before: Mapping[str, Set[str]], after: Mapping[str, Set[str]], key: str
) -> list[dict[str, Any]]:
    """Return the topics whose nodes have changed, with those that each has now."""
    return [
        {"name": topic, key: sorted(after.get(topic, ()))}
        for topic in sorted({*after, *before})
        if after.get(topic) != before.get(topic)
    ]


def service(id_: int, robot: str, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description of a service; `arguments` is the JSON schema of its request."""
    return {
        "id": id_,
        "name": f"/{robot}/{name}",
        "type": f"cairn/{name}",
        "request": _json_schema(f"cairn/{name}_Request", arguments),
        "response": _json_schema(f"cairn/{name}_Response", {"type": "object"}),
    }


def _json_schema(name: str, schema: Mapping[str, Any]) -> dict[str, str]:
    return {
        "encoding": "json",
        "schemaName": name,
        "schemaEncoding": "jsonschema",
        "schema": json.dumps(schema),
    }


def status(level: int, message: str) -> dict[str, Any]:
    """Return a `status` message."""
    return {"op": "status", "level": level, "message": message}
