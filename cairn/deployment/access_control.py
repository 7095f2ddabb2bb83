"""Access control on network endpoints: who may do what, generated from the deployment.

The rules are Zenoh's (`access_control`), for the gateway between the network and the local router.
What no rule allows is denied. Rules exist for both directions (flows), seen from the gateway: from
a user to the robot (ingress) and from the robot to a user (egress). The link to the local router is
the only one over a Unix socket; it may do everything.
"""

from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final, Literal, get_args

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.keys import ROS_NAMES
from cairn.bus.roles import Role
from cairn.deployment.machines import components_by_machine
from cairn.deployment.model import ROOT, Deployment, root_name, view_name
from cairn.deployment.plugins import load_plugin
from cairn.deployment.ros_names import ros_services, ros_topics
from cairn.runtime.call_log import call_log_topic
from cairn.runtime.ports import actions_of, ports_of, services_of
from cairn.runtime.runtime import STATUS_TOPIC
from cairn.runtime.service_events import SERVICE_EVENT_TOPIC
from cairn.schemas.cairn_msgs import MACHINE_STATUS
from cairn.schemas.message import type_name

_EVERY_MESSAGE: Final = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
_EVERY_KEY: Final = ("**", "**/@adv/**", "@ros2_lv/**", "@cairn/**", "@/*/router/**")
"""`**` does not match chunks that begin with @.

The last one is the gateway's description of its links, by which the processes of a deployment that
joins find each other.
"""

_ROUTERS: Final = ("@/*/router/**",)

_LOCAL: Final = "the local router"
_VIEWED_BY_ALL: Final = "parameters"
"""The request that every component answers with its parameters and their values."""
_VIEWED_SERVICES: Final = (
    "get_$*", "describe_parameters", "list_parameters", "_container/list_nodes",
)  # fmt: skip
"""The services below each node's name that only read."""
_RUN: Final = "run"
"""The request that the root answers with the deployment as it runs."""

Flow = Literal["ingress", "egress"]


def access_control(deployment: Deployment) -> dict[str, Any]:
    """Return the value of Zenoh's `access_control` for the gateway of a deployment.

    It depends on the deployment and its plugins' classes only.
    """
    topics, requests = _operator_topics(deployment), _requests(deployment)
    confidential = _input_topics(deployment, "confidential_inputs")
    if deployment.has_call_log:  # which has the arguments of requests, such as the tokens of leases
        logs = f"{deployment.robot}/{call_log_topic('*')}"
        confidential["call logs"] = (f"{deployment.domain}/{logs}/*/*",)
    # The calls of services may have such arguments, too.
    confidential["service events"] = (f"{deployment.domain}/**/{SERVICE_EVENT_TOPIC}/*/*",)
    roles: Mapping[Role, list[dict[str, Any]]] = {
        "view": _view_rules(deployment.domain, requests["view"], confidential),
        "operate": _operate_rules(deployment.domain, topics, requests["operate"]),
        "administer": [_rule("everything", "ingress", _EVERY_MESSAGE, _EVERY_KEY),
                       _rule("everything", "egress", _EVERY_MESSAGE, _EVERY_KEY)],
    }  # fmt: skip
    granted: Mapping[Role, tuple[Role, ...]] = {
        "view": ("view",),
        "operate": ("view", "operate"),
        "administer": ("administer",),
    }
    subjects = [{"id": _LOCAL, "link_protocols": ["unixsock-stream"]}]
    policies = [{"subjects": [_LOCAL], "rules": [one["id"] for one in roles["administer"]]}]
    for role in get_args(Role):
        if members := _members(deployment, role):
            subjects.append({"id": role, **members})
            rules = [one["id"] for part in granted[role] for one in roles[part]]
            policies.append({"subjects": [role], "rules": rules})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for part in roles.values() for rule in part],
        "subjects": subjects,
        "policies": policies,
    }


def machine_access(deployment: Deployment, machine: str) -> dict[str, Any]:
    """Return the value of Zenoh's `access_control` for the router of a machine.

    Another machine publishes what its components publish and what operators may, announces and
    answers for its own components, and reads what its commands show. It may make every request, as
    the users of each machine administer the robot. What no rule allows is denied; local links may
    do everything. `admitted` adds the certificates.
    """
    everything = [
        _rule("everything", "ingress", _EVERY_MESSAGE, _EVERY_KEY),
        _rule("everything", "egress", _EVERY_MESSAGE, _EVERY_KEY),
    ]
    rules = list(everything)
    policies = [{"subjects": [_LOCAL], "rules": [one["id"] for one in everything]}]
    for other in deployment.machines:
        if other != machine:
            allowed = _machine_rules(deployment, other)
            rules += allowed
            policies.append({"subjects": [other], "rules": [one["id"] for one in allowed]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": _LOCAL, "link_protocols": ["unixsock-stream"]}],
        "policies": policies,
    }


def admitted(
    access: Mapping[str, Any], common_names: Mapping[str, tuple[str, ...]]
) -> dict[str, Any]:
    """Return the `machine_access` for certificates with these common names, by machine.

    A machine without any may do nothing.
    """
    subjects = list(access["subjects"])
    policies = []
    for policy in access["policies"]:
        (name,) = policy["subjects"]
        names = common_names.get(name, ())
        if names:
            subjects.append({"id": name, "cert_common_names": list(names)})
        if names or name == _LOCAL:
            policies.append(policy)
    return {**access, "subjects": subjects, "policies": policies}


def _machine_rules(deployment: Deployment, machine: str) -> list[dict[str, Any]]:
    """Return what a machine may do at the router of another one."""
    domain, robot = deployment.domain, deployment.robot
    names = _nodes_on(deployment, machine)
    topics, services = _published_by(deployment, names)
    own = tuple(f"{domain}/{robot}/{name}/**" for name in names)
    data = (
        *topics,
        *own,
        *(f"{domain}{topic}/*/*" for topic in ("/rosout", "/parameter_events")),
        *(f"{domain}/{robot}/{topic}/*/*" for topic in (STATUS_TOPIC, MACHINE_STATUS)),
    )
    cached = tuple(f"{key}/@adv/**" for key in data)
    controls = tuple(f"{keys.control_key(domain, f'/{robot}/{name}')}" for name in names)
    answers = (*services, *own, *controls, *cached, keys.session_key("*"))
    tokens = tuple(f"{keys.TOKENS}/{domain}/*/*/*/*/*/%{robot}/{name}/**" for name in names)
    all_data = (f"{domain}/**", f"{domain}/**/@adv/**")
    of_robots = (*all_data, f"@cairn/{domain}/**", keys.session_key("*"), keys.router_key("*"))
    graph = (keys.tokens_pattern(domain), all_data[1])
    confidential = _confidential_for(deployment, names)
    prefix = f"machine {machine}"
    rules = [
        _rule(f"{prefix}: publish", "ingress", ("put", "delete"), (*data, *cached)),
        _rule(f"{prefix}: answer", "ingress", ("declare_queryable",), answers),
        _rule(f"{prefix}: reply", "ingress", ("reply",), (*data, *answers, *_ROUTERS)),
        _rule(f"{prefix}: announce", "ingress", ("liveliness_token",), (*tokens, *cached)),
        _rule(f"{prefix}: subscribe", "ingress", ("declare_subscriber",), all_data),
        _rule(f"{prefix}: request", "ingress", ("query",), of_robots),
        _rule(
            f"{prefix}: read the graph",
            "ingress",
            ("liveliness_query", "declare_liveliness_subscriber"),
            graph,
        ),
        _rule(f"{prefix}: all", "egress", _EVERY_MESSAGE, (*of_robots, *graph, *_ROUTERS)),
    ]
    if confidential:
        rules.append(
            _rule(f"{prefix}: confidential", "egress", ("put", "reply"), confidential, "deny")
        )
    return rules


def _nodes_on(deployment: Deployment, machine: str) -> list[str]:
    """Return the names of the nodes of a machine: components, root, and `cairn up`."""
    main = deployment.main_machine
    components = components_by_machine(deployment)[machine]
    return [*components, root_name(machine, main), view_name(machine, main)]


def _published_by(
    deployment: Deployment, names: Collection[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the keys of the topics that components may publish on, and of their services.

    What operators may publish is among them: consoles run on every machine.
    """
    topics = [key for one in _operator_topics(deployment).values() for key in one]
    services = []
    for member in deployment.members():
        if member.name not in names:
            continue
        cls = load_plugin(member.spec.plugin)
        for port in ports_of(cls).values():
            if port.direction == "out":
                topic = full_name(deployment.robot, member.spec.topics.get(port.name, port.name))
                kind = keys.dds_type(type_name(port.message))
                topics.append(f"{deployment.domain}{topic}/{kind}/*")
        actions = actions_of(cls)
        for name in (*services_of(cls), *actions):
            full = full_name(deployment.robot, member.spec.topics.get(name, name))
            services.append(f"{deployment.domain}{full}/**")
            if name in actions:  # feedback and status
                topics.append(f"{deployment.domain}{full}/_action/**")
    if deployment.ros_names and ROS_NAMES in names:
        for one in ros_topics(deployment):
            topics += [f"{deployment.domain}{topic}/*/*" for topic in (one.source, one.target)]
        services += [f"{deployment.domain}{one.name}/**" for one in ros_services(deployment)]
    return tuple(dict.fromkeys(topics)), tuple(dict.fromkeys(services))


def _confidential_for(deployment: Deployment, names: Collection[str]) -> tuple[str, ...]:
    """Return the keys of confidential topics that no component of these names uses."""
    used = {
        full_name(deployment.robot, member.spec.topics.get(port, port))
        for member in deployment.members()
        if member.name in names
        for port in ports_of(load_plugin(member.spec.plugin))
    }
    topics = _input_topics(deployment, "confidential_inputs")
    return tuple(key for topic, found in topics.items() if topic not in used for key in found)


def _members(deployment: Deployment, role: Role) -> dict[str, list[str]]:
    """Return the users, or the common names of certificates, with a role."""
    bus = deployment.bus
    users = sorted(name for name, user in bus.users.items() if user.role == role)
    certificates = bus.tls.certificate_roles if bus.tls is not None else {}
    names = sorted(name for name, given in certificates.items() if given == role)
    # A subject with both would be one that has a user name and a certificate.
    return {"usernames": users} if users else {"cert_common_names": names} if names else {}


def _view_rules(
    domain: int, requests: Iterable[str], confidential: Mapping[str, tuple[str, ...]]
) -> list[dict[str, Any]]:
    """Subscribe to every topic, read the graph, and make the requests that only read.

    Messages on confidential topics are denied, which outweighs what is allowed.
    """
    topics, cached = f"{domain}/**", f"{domain}/**/@adv/**"
    denied = tuple(key for topic in confidential for key in confidential[topic])
    tokens = keys.tokens_pattern(domain)
    queryables = (topics, cached, f"@cairn/{domain}/component/*/*/*")
    queries = (cached, *requests)
    return [
        _rule("view: subscribe", "ingress", ("declare_subscriber",), (topics, cached)),
        _rule("view: receive", "egress", ("put", "delete"), (topics, cached)),
        _rule(
            "view: read the graph",
            "ingress",
            ("liveliness_query", "declare_liveliness_subscriber"),
            (tokens, cached),
        ),
        _rule("view: the graph", "egress", ("liveliness_token",), (tokens, cached)),
        _rule("view: what answers", "egress", ("declare_queryable",), queryables),
        _rule("view: request", "ingress", ("query",), queries),
        # A publisher's cache replies with the keys of its messages.
        _rule("view: reply", "egress", ("reply",), (topics, *queries)),
        _rule("view: confidential", "egress", ("put", "reply"), denied, permission="deny"),
    ]


def _operate_rules(
    domain: int, topics: Mapping[str, tuple[str, ...]], requests: Iterable[str]
) -> list[dict[str, Any]]:
    """Publish on the topics that are meant for operators, and give orders."""
    rules = []
    data = tuple(key for topic in topics for key in topics[topic])
    if data:
        cached = tuple(f"{key}/@adv/**" for key in data)
        own = (
            f"{keys.TOKENS}/{domain}/*/*/*/NN/**",
            f"{keys.TOKENS}/{domain}/*/*/*/MS/**",
            *(
                f"{keys.TOKENS}/{domain}/*/*/*/MP/*/*/*/{topic.replace('/', '%')}/**"
                for topic in topics
            ),
            *cached,
        )
        rules = [
            _rule("operate: publish", "ingress", ("put", "delete"), (*data, *cached)),
            _rule("operate: subscribers", "egress", ("declare_subscriber",), (*data, *cached)),
            # A latched publisher keeps its last message, and answers late subscribers.
            _rule("operate: cache", "ingress", ("declare_queryable",), cached),
            _rule("operate: answer", "ingress", ("reply",), (*data, *cached)),
            _rule("operate: asked", "egress", ("query",), cached),
            _rule("operate: announce", "ingress", ("liveliness_token",), own),
            _rule(
                "operate: announced",
                "egress",
                ("liveliness_query", "declare_liveliness_subscriber"),
                own,
            ),
        ]
    if requests:
        clients = tuple(
            f"{keys.TOKENS}/{domain}/*/*/*/SC/*/*/*/%{service.replace('/', '%')}/**"
            for service in _names(requests)
        )
        if clients:
            rules.append(_rule("operate: clients", "ingress", ("liveliness_token",), clients))
        rules += [
            _rule("operate: request", "ingress", ("query",), tuple(requests)),
            _rule("operate: reply", "egress", ("reply",), tuple(requests)),
        ]
    return rules


def _names(requests: Iterable[str]) -> list[str]:
    """Return the names of services, without the first slash, from the keys of requests."""
    return [key.split("/", 1)[1].rsplit("/", 2)[0] for key in requests if key[0] != "@"]


def _rule(
    name: str,
    flow: Flow,
    messages: Iterable[str],
    on: Iterable[str],
    permission: Literal["allow", "deny"] = "allow",
) -> dict[str, Any]:
    return {
        "id": f"{name} ({flow})",
        "permission": permission,
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(on),
    }


def _operator_topics(deployment: Deployment) -> dict[str, tuple[str, ...]]:
    """Return the topics (full names) on which operators may publish, each with its keys."""
    topics = _input_topics(deployment, "operator_inputs")
    for name in deployment.external_topics:  # the type may be one that no component here has
        topic = full_name(deployment.robot, name)
        topics[topic] = (f"{deployment.domain}{topic}/*/*",)
    for one in ros_topics(deployment) if deployment.ros_names else ():
        if one.target in topics:
            topics[one.source] = (keys.message_key(deployment.domain, one.source, one.message),)
    return topics


def _input_topics(
    deployment: Deployment, attribute: Literal["operator_inputs", "confidential_inputs"]
) -> dict[str, tuple[str, ...]]:
    """Return the topics (full names) of the inputs that this attribute names, with their keys."""
    topics: dict[str, tuple[str, ...]] = {}
    for member in deployment.members():
        cls = load_plugin(member.spec.plugin)
        ports = ports_of(cls)
        for port in sorted(getattr(cls, attribute)):
            topic = full_name(deployment.robot, member.spec.topics.get(port, port))
            kind = type_name(ports[port].message)
            topics[topic] = (f"{deployment.domain}{topic}/{keys.dds_type(kind)}/*",)
    return topics


def _services(deployment: Deployment) -> dict[str, Role]:
    """Return the services (full names) that a role below `administer` may call."""
    found: dict[str, Role] = {}
    for member in deployment.members():
        cls = load_plugin(member.spec.plugin)
        actions = actions_of(cls)
        for port, role in sorted(cls.service_roles.items()):
            name = full_name(deployment.robot, member.spec.topics.get(port, port))
            if port in actions:
                found |= {f"{name}/{part}": role for part in actions[port].services()}
            else:
                found[name] = role
    if deployment.ros_names:
        roles = [(one.name, found.get(one.server)) for one in ros_services(deployment)]
        found |= {name: role for name, role in roles if role is not None}
    return found


def _requests(deployment: Deployment) -> dict[Role, list[str]]:
    """Return the keys of the requests that each role adds to those of the role below it."""
    found: dict[Role, list[str]] = {"view": [], "operate": [], "administer": []}
    root = full_name(deployment.robot, ROOT)
    found["view"].append(keys.control_key(deployment.domain, root, _RUN))
    for node in (root, *(full_name(deployment.robot, one.name) for one in deployment.members())):
        found["view"] += [f"{deployment.domain}{node}/{name}/*/*" for name in _VIEWED_SERVICES]
    for service, role in _services(deployment).items():
        found[role].append(f"{deployment.domain}{service}/*/*")
    for member in deployment.members():
        component = full_name(deployment.robot, member.name)
        roles = {_VIEWED_BY_ALL: "view", **load_plugin(member.spec.plugin).request_roles}
        for verb, role in sorted(roles.items()):
            found[role].append(keys.control_key(deployment.domain, component, verb))
    return found
