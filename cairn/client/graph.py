"""The nodes on the bus, those of ROS 2 included, and what they publish, subscribe and serve."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

from cairn.bus import keys
from cairn.bus.conflicts import endpoint_qos_mismatch, endpoint_type_conflict
from cairn.bus.qos import Qos
from cairn.client.connection import Connection

_ACTION_PART: Final = "/_action/"
_SEND_GOAL: Final = "/_action/send_goal"
_MAX_COMPARED = 50  # endpoints of one name

Role = Literal[
    "publisher", "subscriber",
    "service server", "service client", "action server", "action client",
]  # fmt: skip
_ORDER: Final = get_args(Role)
_ROLES: Final[dict[keys.EndpointKind, Role]] = {
    "MP": "publisher", "MS": "subscriber", "SS": "service server", "SC": "service client",
}  # fmt: skip


@dataclass(frozen=True)
class Endpoint:
    """What one node does with one topic, service or action.

    Attributes:
        node: full name of the node.
        is_foreign: whether the node is not a component of Cairn, such as one of ROS 2.
        role: what it is of the topic, service or action.
        name: full name of the topic, service or action.
        type_name: its type in ROS 2, as the node announces it.
        type_hash: hash of the type's definition (RIHS01), that of the goal's service for an action.
        qos: quality of service that a publisher offers or a subscriber requests; announced only.
    """

    node: str
    is_foreign: bool
    role: Role
    name: str
    type_name: str
    type_hash: str
    qos: Qos

    @property
    def is_part_of_action(self) -> bool:
        """Whether it is a topic or service of which an action consists."""
        return _ACTION_PART in self.name


@dataclass(frozen=True)
class NodeInfo:
    """A node on the bus.

    Attributes:
        name: full name, `/robot/localizer`.
        is_foreign: whether it is not a component of Cairn, such as a node of ROS 2.
        is_unique: whether no other node has this name.
        endpoints: what it publishes, subscribes, serves and calls, in this order; without the
            topics and services of which actions consist.
    """

    name: str
    is_foreign: bool
    is_unique: bool
    endpoints: tuple[Endpoint, ...]

    @property
    def namespace(self) -> str:
        """The part of its name before the last one: `/robot`, or `/`."""
        return self.name.rpartition("/")[0] or "/"

    def names(self, role: Role) -> list[str]:
        """Return the full names of what it publishes, or does in another role."""
        return [one.name for one in self.endpoints if one.role == role]


def read_nodes(connection: Connection, *, patience_s: float | None = None) -> list[NodeInfo]:
    """Return all nodes, sorted by name; after `patience_s` [s] those that are known by then."""
    graph = connection.graph(patience_s)
    nodes = [one for one in graph if isinstance(one, keys.NodeEntity)]
    ends: defaultdict[keys.NodeEntity, list[Endpoint]] = defaultdict(list)
    for one in graph:
        if isinstance(one, keys.EndpointEntity):
            end = endpoint_of(one)
            if not end.is_part_of_action:
                ends[one.node].append(end)
    number = Counter(node.name for node in nodes)
    return [
        NodeInfo(
            node.name,
            node.is_foreign,
            number[node.name] == 1,
            tuple(sorted(ends[node], key=_by_role)),
        )
        for node in sorted(nodes, key=lambda node: (node.name, node.zid))
    ]


def endpoint_of(entity: keys.EndpointEntity) -> Endpoint:
    """Return an endpoint for users; the service that accepts an action's goals is the action."""
    role, name, type_name = _ROLES[entity.kind], entity.topic, entity.type_name
    if entity.kind in ("SS", "SC") and name.endswith(_SEND_GOAL):
        role = "action server" if entity.kind == "SS" else "action client"
        name, type_name = name.removesuffix(_SEND_GOAL), type_name.removesuffix("_SendGoal")
    node = entity.node
    return Endpoint(node.name, node.is_foreign, role, name, type_name, entity.type_hash, entity.qos)


def _by_role(end: Endpoint) -> tuple[int, str, str]:
    return _ORDER.index(end.role), end.name, end.type_name


def nodes_in(ends: Iterable[Endpoint], *roles: Role) -> tuple[str, ...]:
    """Return the full names of the nodes that have one of the roles, sorted."""
    return tuple(sorted({one.node for one in ends if one.role in roles}))


def foreign_in(ends: Iterable[Endpoint]) -> tuple[str, ...]:
    """Return the full names of the nodes that are not components of Cairn, sorted."""
    return tuple(sorted({one.node for one in ends if one.is_foreign}))


def problems_of(ends: Iterable[keys.EndpointEntity]) -> tuple[str, ...]:
    """Return what keeps endpoints of one name apart: types, and QoS by the rules of ROS 2.

    Subscriptions are compared with publishers only. Of more than 50 endpoints, only the first 50
    are compared.
    """
    compared: Sequence[keys.EndpointEntity] = list(itertools.islice(ends, _MAX_COMPARED))
    found = (
        endpoint_type_conflict(one, other) or endpoint_qos_mismatch(one, other)
        for one, other in itertools.combinations(compared, 2)
        if (one.kind, other.kind) != ("MS", "MS")
    )
    return tuple(dict.fromkeys(filter(None, found)))
