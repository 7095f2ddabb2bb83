"""rmw_zenoh's conventions: key expressions, attachments, GIDs and liveliness tokens (Jazzy)."""

import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import xxhash

from cairn.bus.qos import Qos
from cairn.errors import CairnError
from cairn.schemas.message import type_name

if TYPE_CHECKING:
    from cairn.bus.codec import Codec

TOKENS = "@ros2_lv"
DEFAULT_DEPTH = 42
_ATTACHMENT = struct.Struct("<qqB16s")
_ROOT = "%"
_NUMBER = re.compile("[0-9]{1,19}", re.ASCII)
_QOS = re.compile(
    "(?P<reliability>[0-4]?):(?P<durability>[0-4]?):(?P<history>[0-3]?),(?P<depth>[0-9]{0,19})"
    ":[0-9]{0,19},[0-9]{0,19}:[0-9]{0,19},[0-9]{0,19}:[0-5]?,[0-9]{0,19},[0-9]{0,19}",
    re.ASCII,
)

EndpointKind = Literal["MP", "MS", "SS", "SC"]
"""Message publisher, message subscription, service server, service client."""


class WireFormatError(CairnError):
    """Something on the bus is not of rmw_zenoh's format."""


class Attachment(NamedTuple):
    """What goes with every message: its number (from 1), when it was sent [ns], by whom."""

    sequence: int
    sent_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """The 33 bytes on the wire."""
        return _ATTACHMENT.pack(self.sequence, self.sent_ns, 16, self.gid)

    @classmethod
    def decode(cls, data: bytes) -> "Attachment":
        """Read the 33 bytes; `WireFormatError` if they are not an attachment."""
        if len(data) != _ATTACHMENT.size or data[16] != 16:
            raise WireFormatError(
                f"an attachment has {_ATTACHMENT.size} bytes with 16 at place 16, not "
                f"{len(data)} bytes {data[:40].hex()}"
            )
        sequence, sent_ns, _, gid = _ATTACHMENT.unpack(data)
        return cls(sequence, sent_ns, gid)


@dataclass(frozen=True)
class NodeEntity:
    """A node as its liveliness token names it; `name` is its full name, `/robot/localizer`.

    `enclave` is the name under which it has its security keys, `/` without any.
    """

    domain: int
    zid: str
    node_id: int
    name: str
    enclave: str = "/"


@dataclass(frozen=True)
class EndpointEntity:
    """A publisher, subscription or service end of a node, as its liveliness token names it."""

    node: NodeEntity
    endpoint_id: int
    kind: EndpointKind
    topic: str
    type_name: str
    type_hash: str
    qos: Qos

    @property
    def data_key(self) -> str:
        """The key expression on which the messages of this endpoint travel."""
        return data_key(self.node.domain, self.topic, self.type_name, self.type_hash)


def data_key(domain: int, topic: str, ros_name: str, type_hash: str) -> str:
    """Return the key expression on which the messages of a topic travel."""
    return f"{domain}/{topic.strip('/')}/{dds_type(ros_name)}/{type_hash}"


def message_key(domain: int, topic: str, message: type[Any], codec: "Codec") -> str:
    """Return the key expression of a topic (full name) with messages of class `message`."""
    return data_key(domain, topic, type_name(message), codec.type_hash(message))


def cached_samples_key(key: str) -> str:
    """Return the key on which latched publishers of `key` answer with their cached messages."""
    return f"{key}/@adv/**"


def tokens_pattern(domain: int) -> str:
    """Return the key expression that matches every liveliness token of a domain."""
    return f"{TOKENS}/{domain}/**"


def control_key(domain: int, component: str) -> str:
    """Return the key of the control queryable of a component (full name `/robot/localizer`)."""
    return f"@cairn/{domain}/component{component}"


def session_key(zid: str) -> str:
    """Return the key on which the process with that session id answers discovery queries."""
    return f"@cairn/session/{zid}"


def router_key(zid: str) -> str:
    """Return the key in a router's admin space that describes the router and its links."""
    return f"@/{zid}/router"


def dds_type(ros_name: str) -> str:
    """`std_msgs/msg/String` as DDS writes it: `std_msgs::msg::dds_::String_`."""
    package, kind, name = ros_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds: str) -> str:
    """The reverse of `dds_type`; `WireFormatError` if it is none."""
    parts = dds.split("::")
    if len(parts) != 4 or not all(parts) or parts[2] != "dds_" or not re.fullmatch(".+_", parts[3]):
        raise WireFormatError(
            f"{_short(dds)} is not a DDS type name such as std_msgs::msg::dds_::String_"
        )
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def gid(token: str) -> bytes:
    """The 16-byte identity of the entity that has this liveliness token."""
    digest = xxhash.xxh3_128_intdigest(token.encode())
    return digest.to_bytes(16, "little")


def token_key(entity: NodeEntity | EndpointEntity) -> str:
    """The key of the liveliness token that announces a node or an endpoint."""
    node = entity if isinstance(entity, NodeEntity) else entity.node
    namespace, _, name = node.name.rpartition("/")
    head = f"{TOKENS}/{node.domain}/{node.zid}/{node.node_id}"
    place = f"{_mangle(node.enclave)}/{_mangle(namespace) or _ROOT}/{name}"
    if isinstance(entity, NodeEntity):
        return f"{head}/{node.node_id}/NN/{place}"
    return (
        f"{head}/{entity.endpoint_id}/{entity.kind}/{place}/{_mangle(entity.topic)}/"
        f"{dds_type(entity.type_name)}/{entity.type_hash}/{qos_chunk(entity.qos)}"
    )


def parse_token(key: str) -> NodeEntity | EndpointEntity:
    """Read a liveliness token's key; `WireFormatError` if it is not one of rmw_zenoh's."""
    chunks = key.split("/")
    if chunks[0] != TOKENS or len(chunks) not in (9, 13) or not all(chunks):
        raise WireFormatError(f"{_short(key)} is not a liveliness token of rmw_zenoh")
    _, domain, zid, node_id, endpoint_id, kind, enclave, namespace, name = chunks[:9]
    if not all(_NUMBER.fullmatch(number) for number in (domain, node_id, endpoint_id)):
        raise WireFormatError(f"{_short(key)}: domain, node and entity must be numbers")
    full = f"{'' if namespace == _ROOT else _demangle(namespace)}/{name}"
    node = NodeEntity(int(domain), zid, int(node_id), full, _demangle(enclave))
    if kind == "NN" and len(chunks) == 9:
        return node
    if kind not in ("MP", "MS", "SS", "SC") or len(chunks) != 13:
        raise WireFormatError(
            f"{_short(key)}: {kind!r} is not a kind of entity with {len(chunks)} chunks"
        )
    topic, dds, type_hash, qos = chunks[9:]
    return EndpointEntity(
        node=node,
        endpoint_id=int(endpoint_id),
        kind=cast("EndpointKind", kind),
        topic=_demangle(topic),
        type_name=ros_type(dds),
        type_hash=type_hash,
        qos=parse_qos_chunk(qos),
    )


def qos_chunk(qos: Qos) -> str:
    """A port's QoS as the tokens carry it; fields equal to the defaults are empty."""
    reliability = "" if qos.reliability == "reliable" else "2"
    durability = "" if qos.durability == "volatile" else "1"
    depth = "" if qos.depth == DEFAULT_DEPTH else str(qos.depth)
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def parse_qos_chunk(chunk: str) -> Qos:
    """Read a token's QoS; `WireFormatError` if it is malformed.

    Policies left to the system count as the defaults, and so does the depth of "keep all". What
    Cairn has no word for (deadline, lifespan, liveliness) is checked and left out.
    """
    found = _QOS.fullmatch(chunk)
    if found is None:
        raise WireFormatError(f"{_short(chunk)} is not a QoS chunk such as ::,10:,:,:,,")
    return Qos(
        "best_effort" if found["reliability"] == "2" else "reliable",
        "transient_local" if found["durability"] == "1" else "volatile",
        int(found["depth"] or 0) or DEFAULT_DEPTH,
    )


def _mangle(name: str) -> str:
    return name.replace("/", "%")


def _demangle(name: str) -> str:
    return name.replace("%", "/")


def _short(text: str) -> str:
    return repr(text) if len(text) <= 300 else f"{text[:300]!r}..."
