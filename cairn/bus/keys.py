"""Zenoh keys: every key expression of Cairn, and rmw_zenoh's tokens and attachments (ROS 2 Jazzy).

Data keys, liveliness tokens, attachments and GIDs follow rmw_zenoh, so that ROS 2 nodes on the bus
understand them. Keys that begin with `@cairn` are Cairn's own, which ROS 2 does not see.
"""

import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import xxhash

from cairn.bus.exclusive import PROOF_BYTES
from cairn.bus.qos import Qos
from cairn.bus.type_hash import type_hash
from cairn.errors import CairnError
from cairn.schemas.message import type_name

if TYPE_CHECKING:
    import zenoh

TOKENS = "@ros2_lv"
"""First chunk of every liveliness token of rmw_zenoh."""

ROS_NAMES = "ros_names"
"""Name of the node that gives a robot's topics their ROS names, without the robot's name."""

DEFAULT_DEPTH = 42
"""The depth that rmw_zenoh leaves out of its tokens."""

CAIRN_ID_PREFIX = "ca1c0de5"
"""Prefix of the session ids of components and routers, which answer discovery queries.

The process id follows, so that a process that does not answer can be named without asking it, and
a random number. The last four bytes prove that the session is one of the run: a tag of the others,
keyed by the run's secret.
"""

PID_DIGITS = 8
"""Hexadecimal digits of the process id in a session id."""

_ATTACHMENT = struct.Struct("<qqB16s")
LONGEST_ATTACHMENT = _ATTACHMENT.size + 1 + PROOF_BYTES
"""Length of an attachment with the proof of an exclusive topic's writer [bytes]."""

_ROOT = "%"
_LONGEST_IDENTITY = 255
_NUMBER = re.compile("[0-9]{1,19}", re.ASCII)
_QOS = re.compile(
    "(?P<reliability>[0-4]?):(?P<durability>[0-4]?):(?P<history>[0-3]?),(?P<depth>[0-9]{0,19})"
    ":[0-9]{0,19},[0-9]{0,19}:[0-9]{0,19},[0-9]{0,19}:[0-5]?,[0-9]{0,19},[0-9]{0,19}",
    re.ASCII,
)

EndpointKind = Literal["MP", "MS", "SS", "SC"]
"""Kind of an endpoint: message publisher, message subscription, service server, service client."""


class WireFormatError(CairnError):
    """A key or an attachment on the bus does not have rmw_zenoh's format."""


class Attachment(NamedTuple):
    """What is sent with every message.

    `sequence` is its number, from 1 for each publisher; `sent_ns` when it was sent, in nanoseconds
    since 1970-01-01 UTC; `gid` the 16-byte identity of the publisher. `proof` is that of an
    exclusive topic's writer (`cairn.bus.exclusive`); rmw_zenoh reads what it knows and ignores the
    bytes behind it.
    """

    sequence: int
    sent_ns: int
    gid: bytes
    proof: bytes = b""

    def encode(self) -> bytes:
        """Return the bytes on the wire: 33, and the proof with its length if there is one."""
        return signed_attachment(self.head(), self.proof) if self.proof else self.head()

    def head(self) -> bytes:
        """Return the 33 bytes that every attachment has."""
        return plain_attachment(self.sequence, self.sent_ns, self.gid)

    @classmethod
    def decode(cls, data: bytes) -> "Attachment":
        """Return an attachment from its bytes; `WireFormatError` if they are not an attachment."""
        size = _ATTACHMENT.size
        is_signed = len(data) == LONGEST_ATTACHMENT and data[size] == PROOF_BYTES
        if not (len(data) == size or is_signed) or data[16] != 16:
            raise WireFormatError(
                f"an attachment has {size} bytes, of which byte 16 is 16, and "
                f"{1 + PROOF_BYTES} more if it is signed, not {len(data)} bytes {data[:40].hex()}"
            )
        sequence, sent_ns, _, gid = _ATTACHMENT.unpack_from(data)
        return cls(sequence, sent_ns, gid, data[size + 1 :])

    @classmethod
    def of(cls, sample: "zenoh.Sample | zenoh.Query") -> "Attachment | None":
        """Return a sample's or query's attachment; None if its sender sent none of this form."""
        data = sample.attachment
        if data is None or len(data) > LONGEST_ATTACHMENT:
            return None
        try:
            return cls.decode(data.to_bytes())
        except WireFormatError:
            return None


def sent_ns(sample: "zenoh.Sample") -> int:
    """Return when a sample was sent [ns]; 0 if its attachment does not have it."""
    sent = Attachment.of(sample)
    return 0 if sent is None else sent.sent_ns


def plain_attachment(sequence: int, sent_ns: int, gid: bytes) -> bytes:
    """Return the bytes of an attachment without proof."""
    return _ATTACHMENT.pack(sequence, sent_ns, 16, gid)


def signed_attachment(head: bytes, proof: bytes) -> bytes:
    """Return the bytes of an attachment with a proof behind those of one without."""
    return head + bytes([len(proof)]) + proof


@dataclass(frozen=True)
class NodeEntity:
    """A node, as described by its liveliness token.

    `name` is its full name, `/robot/localizer`; `node_id` is unique in its session, a number in
    rmw_zenoh, a text in dora-rs; `enclave` names its security keys, `/` for none.
    """

    domain: int
    zid: str
    node_id: int | str
    name: str
    enclave: str = "/"

    @property
    def is_foreign(self) -> bool:
        """Whether it is not in a process of Cairn, as its session id shows; it may be forged."""
        return process_id(self.zid) is None


@dataclass(frozen=True)
class EndpointEntity:
    """A publisher, subscription or service endpoint, as described by its liveliness token."""

    node: NodeEntity
    endpoint_id: int | str
    kind: EndpointKind
    topic: str
    type_name: str
    type_hash: str
    qos: Qos

    @property
    def data_key(self) -> str:
        """The key expression on which the messages of this endpoint travel."""
        return data_key(self.node.domain, self.topic, self.type_name, self.type_hash)


def process_id(zid: str) -> int | None:
    """Return the process id in a session id; None if the session is not one of Cairn.

    Unless `cairn.bus.session.is_member` holds, it proves nothing.
    """
    digits = zid.removeprefix(CAIRN_ID_PREFIX)[:PID_DIGITS]
    try:
        return int(digits, 16) if zid.startswith(CAIRN_ID_PREFIX) else None
    except ValueError:
        return None


def data_key(domain: int, topic: str, ros_name: str, type_hash: str) -> str:
    """Return the key expression on which the messages of a topic travel."""
    return f"{domain}/{topic.strip('/')}/{dds_type(ros_name)}/{type_hash}"


def private_services_key(domain: int, service: str, ros_name: str) -> str:
    """Return the key expression of a service and those beside it of the same package."""
    prefix, package = service.rpartition("/")[0], ros_name.partition("/")[0]
    return f"{domain}{prefix}/*/{package}::srv::dds_::$*/*"


def message_key(domain: int, topic: str, message: type[Any]) -> str:
    """Return the key expression of a topic (full name) with messages of class `message`."""
    return data_key(domain, topic, type_name(message), type_hash(message))


def cached_samples_key(key: str) -> str:
    """Return the key on which latched publishers of `key` answer with their cached messages."""
    return f"{key}/@adv/**"


def is_infrastructure(topic: str) -> bool:
    """Return whether a topic (full name) is one that every node has, or is hidden in ROS 2.

    Lists of topics leave these out unless they are asked for.
    """
    last = topic.rpartition("/")[2]
    return (
        topic in ("/rosout", "/parameter_events")
        or last in ("component_status", "transition_event")
        or "/_" in topic  # hidden, as in ROS 2: of an action, or events of a service
    )


def own_name(node: str, topic: str) -> str | None:
    """Return the name with the robot's of a topic that a node (full names) gives its ROS name.

    It is None if the node does not repeat the messages of another topic: see `ros_names` in
    deployments.
    """
    robot, _, name = node.rpartition("/")
    repeats = name == ROS_NAMES and not topic.startswith(f"{robot}/")
    return f"{robot}{topic}" if repeats else None


def tokens_pattern(domain: int) -> str:
    """Return the key expression that matches every liveliness token of a domain."""
    return f"{TOKENS}/{domain}/**"


def nodes_pattern(domain: int | Literal["*"], name: str = "") -> str:
    """Return the key expression that matches the tokens of the node of a full name, or of all.

    `*` stands for all domains.
    """
    namespace, _, last = name.rpartition("/")
    path = f"{_mangle(namespace) or _ROOT}/{last}" if name else "*/*"
    return f"{TOKENS}/{domain}/*/*/*/NN/*/{path}"


def endpoints_pattern(
    domain: int, topic: str = "", kind: EndpointKind | Literal["*", "M$*", "S$*"] = "*"
) -> str:
    """Return the key expression that matches the tokens of the endpoints of a name, or of all.

    `*` in a topic or service (full name) stands for any characters. Kind `M$*` matches the
    endpoints of topics, `S$*` those of services.
    """
    chunk = _mangle(topic).replace("*", "$*") if topic else "*"
    return f"{TOKENS}/{domain}/*/*/*/{kind}/*/*/*/{chunk}/*/*/*"


def control_key(domain: int, component: str, verb: str = "*") -> str:
    """Return the key of a control request to a component (full name `/robot/localizer`).

    The verb is part of the key, so that access control can allow some requests and not others.
    Without a verb, return the key expression of the component's queryable, which matches all.
    """
    return f"@cairn/{domain}/component{component}/{verb}"


def session_key(zid: str) -> str:
    """Return the key on which the process with that session id answers discovery queries."""
    return f"@cairn/session/{zid}"


def router_key(zid: str) -> str:
    """Return the key in a router's admin space that describes the router and its links."""
    return f"@/{zid}/router"


def dds_type(ros_name: str) -> str:
    """Return a ROS 2 type name as DDS writes it: `std_msgs::msg::dds_::String_`."""
    package, kind, name = ros_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds: str) -> str:
    """Return the ROS 2 type name of a DDS type name; `WireFormatError` if it is malformed."""
    parts = dds.split("::")
    if len(parts) != 4 or not all(parts) or parts[2] != "dds_" or not re.fullmatch(".+_", parts[3]):
        raise WireFormatError(
            f"{_short(dds)} is not a DDS type name such as std_msgs::msg::dds_::String_"
        )
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def gid(token: str) -> bytes:
    """Return the 16-byte identity of the entity that has this liveliness token."""
    digest = xxhash.xxh3_128_intdigest(token.encode())
    return digest.to_bytes(16, "little")


def token_key(entity: NodeEntity | EndpointEntity) -> str:
    """Return the key of the liveliness token that announces a node or an endpoint."""
    node = entity if isinstance(entity, NodeEntity) else entity.node
    namespace, _, name = node.name.rpartition("/")
    head = f"{TOKENS}/{node.domain}/{node.zid}/{node.node_id}"
    path = f"{_mangle(node.enclave)}/{_mangle(namespace) or _ROOT}/{name}"
    if isinstance(entity, NodeEntity):
        return f"{head}/{node.node_id}/NN/{path}"
    return (
        f"{head}/{entity.endpoint_id}/{entity.kind}/{path}/{_mangle(entity.topic)}/"
        f"{dds_type(entity.type_name)}/{entity.type_hash}/{qos_chunk(entity.qos)}"
    )


def parse_token(key: str) -> NodeEntity | EndpointEntity:
    """Return what a liveliness token announces; `WireFormatError` if it is not rmw_zenoh's."""
    chunks = key.split("/")
    # Names of ROS 2 are ASCII; others could control the terminal on which they are shown.
    if chunks[0] != TOKENS or len(chunks) not in (9, 13) or not all(chunks) or not _is_plain(key):
        raise WireFormatError(f"{_short(key)} is not a liveliness token of rmw_zenoh")
    _, domain, zid, node_id, endpoint_id, kind, enclave, namespace, name = chunks[:9]
    if not _NUMBER.fullmatch(domain):
        raise WireFormatError(f"{_short(key)}: the domain must be a number")
    if max(len(node_id), len(endpoint_id)) > _LONGEST_IDENTITY:
        raise WireFormatError(f"{_short(key)}: the identity of its node or entity is too long")
    full = f"{'' if namespace == _ROOT else _demangle(namespace)}/{name}"
    node = NodeEntity(int(domain), zid, _identity(node_id), full, _demangle(enclave))
    if kind == "NN" and len(chunks) == 9:
        return node
    if kind not in ("MP", "MS", "SS", "SC") or len(chunks) != 13:
        raise WireFormatError(
            f"{_short(key)}: {kind!r} is not a kind of entity with {len(chunks)} chunks"
        )
    topic, dds, type_hash, qos = chunks[9:]
    return EndpointEntity(
        node=node,
        endpoint_id=_identity(endpoint_id),
        kind=cast("EndpointKind", kind),
        topic=_demangle(topic),
        type_name=ros_type(dds),
        type_hash=type_hash,
        qos=parse_qos_chunk(qos),
    )


def qos_chunk(qos: Qos) -> str:
    """Return a port's QoS as the tokens carry it; fields equal to the defaults are empty."""
    reliability = "" if qos.reliability == "reliable" else "2"
    durability = "" if qos.durability == "volatile" else "1"
    depth = "" if qos.depth == DEFAULT_DEPTH else str(qos.depth)
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def parse_qos_chunk(chunk: str) -> Qos:
    """Return the QoS in a token; `WireFormatError` if it is malformed.

    Policies left to the system count as the defaults, and so does the depth of "keep all".
    Policies that Cairn does not have (deadline, lifespan, liveliness) are checked and left out.
    """
    match = _QOS.fullmatch(chunk)
    if match is None:
        raise WireFormatError(f"{_short(chunk)} is not a QoS chunk such as ::,10:,:,:,,")
    return Qos(
        "best_effort" if match["reliability"] == "2" else "reliable",
        "transient_local" if match["durability"] == "1" else "volatile",
        int(match["depth"] or 0) or DEFAULT_DEPTH,
    )


def _identity(chunk: str) -> int | str:
    # Only as it is written can it be written again: not 007.
    return int(chunk) if _NUMBER.fullmatch(chunk) and str(int(chunk)) == chunk else chunk


def _mangle(name: str) -> str:
    return name.replace("/", "%")


def _demangle(name: str) -> str:
    return name.replace("%", "/")


def _is_plain(key: str) -> bool:
    return key.isascii() and key.isprintable()


def _short(text: str) -> str:
    return repr(text) if len(text) <= 300 else f"{text[:300]!r}..."
