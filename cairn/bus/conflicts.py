"""What keeps two endpoints of a topic or service apart: their types, or QoS as ROS 2 matches it."""

from typing import Literal

from cairn.bus.keys import EndpointEntity, EndpointKind
from cairn.bus.qos import Qos

_COUNTERPARTS: dict[EndpointKind, tuple[EndpointKind, ...]] = {
    "MP": ("MP", "MS"),
    "MS": ("MP", "MS"),
    "SS": ("SS", "SC"),
    "SC": ("SS", "SC"),
}
"""The kinds of endpoints that have to have the same type as one of a kind on the same name."""


def endpoint_type_conflict(one: EndpointEntity, other: EndpointEntity) -> str:
    """Return the problem of two endpoints whose name has two types; empty if there is none."""
    if other.topic != one.topic or other.kind not in _COUNTERPARTS[one.kind]:
        return ""
    first, second = one.type_name, other.type_name
    if (first, one.type_hash) == (second, other.type_hash):
        return ""
    if first == second:
        first = f"{first} ({one.type_hash})"
        second = f"another definition of it ({other.type_hash})"
    kind: Literal["topic", "service"] = "topic" if one.kind in ("MP", "MS") else "service"
    return type_conflict(one.topic, one.node.name, first, other.node.name, second, kind)


def endpoint_qos_mismatch(one: EndpointEntity, other: EndpointEntity) -> str:
    """Return the problem of a publisher and a subscription of a topic; empty if there is none."""
    if other.topic != one.topic or {one.kind, other.kind} != {"MP", "MS"}:
        return ""
    publisher, subscription = (one, other) if one.kind == "MP" else (other, one)
    return qos_mismatch(
        one.topic, publisher.node.name, publisher.qos, subscription.node.name, subscription.qos
    )


def type_conflict(
    name: str,
    one: str,
    its_type: str,
    other: str,
    other_type: str,
    kind: Literal["topic", "service"] = "topic",
) -> str:
    """Return the message about two nodes that use one topic or service with two types."""
    return (
        f"{kind} {name}: {one} uses it with type {its_type}, {other} with {other_type}, so they "
        f"cannot receive each other's messages; rename one of the {kind}s or use the same type"
    )


def qos_mismatch(topic: str, publisher: str, offered: Qos, subscriber: str, requested: Qos) -> str:
    """Return the message about a publisher that offers less than a subscriber requests, else "".

    The rules are those of ROS 2 (https://docs.ros.org/en/jazzy/Concepts/Intermediate/
    About-Quality-of-Service-Settings.html#qos-compatibilities) for the policies that rmw_zenoh
    has. It delivers the messages nevertheless (`rmw_qos_profile_check_compatible` in its qos.cpp),
    as Cairn does.
    """
    policies, effects = [], []
    if requested.reliability == "reliable" and offered.reliability == "best_effort":
        policies.append("reliability")
        effects.append("messages may be lost")
    if requested.latched and not offered.latched:
        policies.append("durability")
        effects.append(f"{subscriber} gets no message from before its start")
    if not policies:
        return ""
    return (
        f"QoS mismatch on topic {topic}: {publisher} offers {offered}, {subscriber} requests "
        f"{requested}; {' and '.join(effects)}, and over DDS none would arrive; give both the same "
        f"{' and '.join(policies)}"
    )
