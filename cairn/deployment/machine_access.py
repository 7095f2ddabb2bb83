"""Access control between the machines of a robot: what each may do at the routers of the others.

A machine has the rights that its components need, also those that only may run on it, such as
fallbacks: it publishes, subscribes, calls and answers exactly what their ports declare. Its role in
the deployment adds what the users there may do by commands, as for users on the network
(`access_control`). It never publishes, announces or answers what another machine's components do.

What Zenoh's rules cannot express: they know keys, not contents. A supervisor with a component on
another machine may make the requests `load`, `unload` and `hold` of the root there, for any
component that this root has.
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any, Final

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.keys import ROS_NAMES
from cairn.deployment.access_control import (
    EVERY_MESSAGE,
    LOCAL,
    ROUTERS,
    confidential_topics,
    everything,
    operator_topics,
    requests_by_role,
    rule,
)
from cairn.deployment.machines import components_by_machine, parents_elsewhere
from cairn.deployment.model import Deployment, Member, root_name, view_name
from cairn.deployment.plugins import load_plugin
from cairn.deployment.ros_name_mapping import ros_services, ros_topics
from cairn.runtime.ports import actions_of, ports_of, services_of
from cairn.runtime.rosout import ROSOUT
from cairn.runtime.runtime import STATUS_TOPIC
from cairn.runtime.service_events import SERVICE_EVENT_TOPIC
from cairn.runtime.timers import CLOCK_TOPIC
from cairn.runtime.topic_ports import In, Out
from cairn.schemas.cairn_msgs import MACHINE_STATUS
from cairn.schemas.lifecycle_msgs.srv import GetState
from cairn.schemas.message import type_name

_REMOTE_REQUESTS: Final = ("load", "unload", "hold")
"""What a supervisor requests of the root on the machine of its child."""

_DECLARATIONS: Final = tuple(one for one in EVERY_MESSAGE if one not in ("put", "delete", "reply"))
"""What carries no data of a component: a machine that receives one learns names only."""


@dataclass
class _Rights:
    """What a machine may do, as key expressions."""

    publish: list[str] = field(default_factory=list)
    read: list[str] = field(default_factory=list)
    answer: list[str] = field(default_factory=list)
    request: list[str] = field(default_factory=list)
    confidential: list[str] = field(default_factory=list)
    """What it may not read although it may read all topics."""


def machine_access(deployment: Deployment, machine: str) -> dict[str, Any]:
    """Return the value of Zenoh's `access_control` for the router of a machine.

    What no rule allows is denied; local links may do everything. `admitted` adds the certificates.
    """
    rules = everything()
    policies = [{"subjects": [LOCAL], "rules": [one["id"] for one in rules]}]
    for other in deployment.machines:
        if other != machine:
            allowed = _machine_rules(deployment, other)
            rules += allowed
            policies.append({"subjects": [other], "rules": [one["id"] for one in allowed]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": LOCAL, "link_protocols": ["unixsock-stream"]}],
        "policies": policies,
    }


def _machine_rules(deployment: Deployment, machine: str) -> list[dict[str, Any]]:
    """Return what a machine may do at the router of another one."""
    domain, robot = deployment.domain, deployment.robot.name
    names = _nodes_on(deployment, machine)
    rights = _rights(deployment, machine, names)
    published, caches = _with_caches(rights.publish)
    read, read_caches = _with_caches(rights.read)
    sessions = (keys.session_key("*"), *ROUTERS)
    requests = (*rights.request, *sessions)
    answers = (*rights.answer, *caches, keys.session_key("*"))
    tokens = tuple(f"{keys.TOKENS}/{domain}/*/*/*/*/*/%{robot}/{name}/**" for name in names)
    graph = (keys.tokens_pattern(domain), *read_caches)
    all_keys = (
        f"{domain}/**", f"{domain}/**/@adv/**", f"@cairn/{domain}/**", keys.tokens_pattern(domain),
        *sessions,
    )  # fmt: skip
    prefix = f"machine {machine}"
    rules = [
        rule(f"{prefix}: publish", "ingress", ("put", "delete"), (*published, *caches)),
        rule(f"{prefix}: answer", "ingress", ("declare_queryable",), answers),
        rule(f"{prefix}: reply", "ingress", ("reply",), (*published, *answers, *ROUTERS)),
        rule(f"{prefix}: announce", "ingress", ("liveliness_token",), (*tokens, *caches)),
        rule(f"{prefix}: subscribe", "ingress", ("declare_subscriber",), (*read, *read_caches)),
        rule(f"{prefix}: request", "ingress", ("query",), (*requests, *read_caches)),
        rule(
            f"{prefix}: read the graph",
            "ingress",
            ("liveliness_query", "declare_liveliness_subscriber"),
            graph,
        ),
        rule(f"{prefix}: receive", "egress", ("put", "delete"), (*read, *read_caches)),
        # A publisher's cache replies with the keys of its messages.
        rule(f"{prefix}: replies", "egress", ("reply",), (*read, *read_caches, *requests)),
        rule(f"{prefix}: declarations", "egress", _DECLARATIONS, all_keys),
    ]
    if rights.confidential:
        rules.append(
            rule(f"{prefix}: confidential", "egress", ("put", "reply"), rights.confidential, "deny")
        )
    return rules


def _with_caches(topics: Collection[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return key expressions of topics, each once, and those of the caches of latched ones."""
    once = tuple(dict.fromkeys(topics))
    return once, tuple(map(keys.cached_samples_key, once))


def _nodes_on(deployment: Deployment, machine: str) -> list[str]:
    """Return the names of the nodes of a machine: components, root, and `cairn up`."""
    main = deployment.main_machine
    components = components_by_machine(deployment)[machine]
    return [*components, root_name(machine, main), view_name(machine, main)]


def _rights(deployment: Deployment, machine: str, names: Collection[str]) -> _Rights:
    """Return what the nodes of a machine need, and what its role adds."""
    domain, robot = deployment.domain, deployment.robot.name
    rights = _Rights()
    # Names below those of the nodes: a topic itself may have the name of a component.
    own = [f"{domain}/{robot}/{name}/*/*/*/**" for name in names]
    rights.publish += [
        *own,
        *(f"{domain}{topic}/*/*" for topic in (ROSOUT, "/parameter_events")),
        f"{domain}/{robot}/{STATUS_TOPIC}/*/*",
    ]
    rights.answer += [*own, *(keys.control_key(domain, f"/{robot}/{name}") for name in names)]
    # By these, every machine knows of all others and of all components: `cairn ps` and `machines`.
    rights.read += [f"{domain}/*/{STATUS_TOPIC}/*/*", f"{domain}/*/*/{MACHINE_STATUS}/*/*"]
    if deployment.clock == "simulated":
        rights.read.append(f"{domain}{full_name(robot, CLOCK_TOPIC)}/*/*")
    used: set[str] = set()
    for member in deployment.members():
        if member.name in names:
            used |= _add_ports(rights, deployment, member)
    if deployment.ros_names and ROS_NAMES in names:
        for one in ros_topics(deployment):
            rights.read.append(f"{domain}{one.source}/*/*")
            rights.publish.append(f"{domain}{one.target}/*/*")
        for service in ros_services(deployment):
            rights.answer.append(f"{domain}{service.name}/*/*")
            rights.request.append(f"{domain}{service.server}/*/*")
    for other in deployment.machines:
        children = [
            child
            for child, parent in parents_elsewhere(deployment, other).items()
            if parent in names
        ]
        if other != machine and children:
            root = full_name(robot, root_name(other, deployment.main_machine))
            rights.request += [keys.control_key(domain, root, verb) for verb in _REMOTE_REQUESTS]
            # A supervisor serves the life cycle of its children, wherever they run.
            rights.answer += [
                keys.private_services_key(
                    domain, full_name(robot, f"{child}/get_state"), type_name(GetState)
                )
                for child in children
            ]
    _add_role(rights, deployment, machine, used)
    return rights


def _add_ports(rights: _Rights, deployment: Deployment, member: Member) -> set[str]:
    """Add what the ports of a component need; return the topics (full names) that it reads."""
    domain, cls = deployment.domain, load_plugin(member.spec.plugin)
    used = set()

    def name_of(port: str) -> str:
        return full_name(deployment.robot.name, member.spec.topics.get(port, port))

    def add_topic(topic: str, port: In[Any] | Out[Any]) -> None:
        key = f"{domain}{topic}/{keys.dds_type(type_name(port.interface))}/*"
        if port.direction == "in":
            used.add(topic)
            rights.read.append(key)
        else:
            rights.publish.append(key)

    for port in ports_of(cls).values():
        add_topic(name_of(port.name), port)
    for service in services_of(cls).values():
        name = name_of(service.name)
        rights.publish.append(f"{domain}{name}/{SERVICE_EVENT_TOPIC}/*/*")
        if service.role == "server":
            rights.answer.append(f"{domain}{name}/*/*")
        else:
            rights.request.append(f"{domain}{name}/*/*")
    for action in actions_of(cls).values():
        name = name_of(action.name)
        if action.role == "server":
            rights.answer += [f"{domain}{name}/{part}/*/*" for part in action.services()]
        else:
            rights.request += [f"{domain}{name}/{part}/*/*" for part in action.services()]
        for part, topic_port in action.topics().items():
            add_topic(f"{name}/{part}", topic_port)
    return used


def _add_role(rights: _Rights, deployment: Deployment, machine: str, used: Collection[str]) -> None:
    """Add what the role of a machine allows; its components read `used` whatever that is."""
    role, domain = deployment.role_of(machine), deployment.domain
    if role is None:
        return
    by_role = requests_by_role(deployment)
    rights.read.append(f"{domain}/**")
    rights.request += by_role["view"]
    if role != "view":
        rights.publish += [key for found in operator_topics(deployment).values() for key in found]
        rights.request += by_role["operate"]
    if role == "administer":
        rights.request += [f"{domain}/**", f"@cairn/{domain}/**"]
    else:
        topics = confidential_topics(deployment)
        rights.confidential += [
            key for topic, found in topics.items() if topic not in used for key in found
        ]
