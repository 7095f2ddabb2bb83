"""Access control on network endpoints: who may do what, generated from the deployment.

The rules are Zenoh's (`access_control`), for the gateway between the network and the local router.
What no rule allows is denied. Rules exist for both directions (flows), seen from the gateway: from
a user to the robot (ingress) and from the robot to a user (egress). The link to the local router is
the only one over a Unix socket; it may do everything.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final, Literal, get_args

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.roles import Role
from cairn.deployment.model import ROOT, Deployment, root_name
from cairn.deployment.plugins import load_plugin
from cairn.deployment.ros_name_mapping import ros_services, ros_topics
from cairn.runtime.call_log import call_log_topic
from cairn.runtime.ports import actions_of, ports_of
from cairn.runtime.service_events import SERVICE_EVENT_TOPIC
from cairn.schemas.message import type_name

EVERY_MESSAGE: Final = (
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
EVERY_KEY: Final = ("**", "**/@adv/**", "@ros2_lv/**", "@cairn/**", "@/*/router/**")
"""`**` does not match chunks that begin with @.

The last one is the gateway's description of its links, by which the processes of a deployment that
joins find each other.
"""

ROUTERS: Final = ("@/*/router/**",)

LOCAL: Final = "the local router"
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

    It depends on the deployment and its plugins' classes only. If operators come from the roster
    of `cairn security` (`bus.tls.identity`), `admitted` adds their certificates.
    """
    topics, requests = operator_topics(deployment), requests_by_role(deployment)
    confidential = confidential_topics(deployment)
    roles: Mapping[Role, list[dict[str, Any]]] = {
        "view": _view_rules(deployment.domain, requests["view"], confidential),
        "operate": _operate_rules(deployment.domain, topics, requests["operate"]),
        "administer": everything(),
    }
    granted: Mapping[Role, tuple[Role, ...]] = {
        "view": ("view",),
        "operate": ("view", "operate"),
        "administer": ("administer",),
    }
    subjects = [{"id": LOCAL, "link_protocols": ["unixsock-stream"]}]
    policies = [{"subjects": [LOCAL], "rules": [one["id"] for one in roles["administer"]]}]
    from_roster = deployment.bus.tls is not None and deployment.bus.tls.identity is not None
    for role in get_args(Role):
        members = _members(deployment, role)
        if members:
            subjects.append({"id": role, **members})
        if members or from_roster:
            rules = [one["id"] for part in granted[role] for one in roles[part]]
            policies.append({"subjects": [role], "rules": rules})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for part in roles.values() for rule in part],
        "subjects": subjects,
        "policies": policies,
    }


def everything() -> list[dict[str, Any]]:
    """Return the rules that allow everything."""
    return [rule("everything", flow, EVERY_MESSAGE, EVERY_KEY) for flow in get_args(Flow)]


def admitted(
    access: Mapping[str, Any], common_names: Mapping[str, tuple[str, ...]]
) -> dict[str, Any]:
    """Return an access control for certificates with these common names, by subject.

    The subjects of `access` are machines (`machine_access`) or the roles of operators. One without
    any certificate may do nothing.
    """
    subjects = list(access["subjects"])
    policies = []
    for policy in access["policies"]:
        (name,) = policy["subjects"]
        names = common_names.get(name, ())
        if names:
            subjects.append({"id": name, "cert_common_names": list(names)})
        if names or name == LOCAL:
            policies.append(policy)
    return {**access, "subjects": subjects, "policies": policies}


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
        rule("view: subscribe", "ingress", ("declare_subscriber",), (topics, cached)),
        rule("view: receive", "egress", ("put", "delete"), (topics, cached)),
        rule(
            "view: read the graph",
            "ingress",
            ("liveliness_query", "declare_liveliness_subscriber"),
            (tokens, cached),
        ),
        rule("view: the graph", "egress", ("liveliness_token",), (tokens, cached)),
        rule("view: what answers", "egress", ("declare_queryable",), queryables),
        rule("view: request", "ingress", ("query",), queries),
        # A publisher's cache replies with the keys of its messages.
        rule("view: reply", "egress", ("reply",), (topics, *queries)),
        rule("view: confidential", "egress", ("put", "reply"), denied, permission="deny"),
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
            rule("operate: publish", "ingress", ("put", "delete"), (*data, *cached)),
            rule("operate: subscribers", "egress", ("declare_subscriber",), (*data, *cached)),
            # A latched publisher keeps its last message, and answers late subscribers.
            rule("operate: cache", "ingress", ("declare_queryable",), cached),
            rule("operate: answer", "ingress", ("reply",), (*data, *cached)),
            rule("operate: asked", "egress", ("query",), cached),
            rule("operate: announce", "ingress", ("liveliness_token",), own),
            rule(
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
            rules.append(rule("operate: clients", "ingress", ("liveliness_token",), clients))
        rules += [
            rule("operate: request", "ingress", ("query",), tuple(requests)),
            rule("operate: reply", "egress", ("reply",), tuple(requests)),
        ]
    return rules


def _names(requests: Iterable[str]) -> list[str]:
    """Return the names of services, without the first slash, from the keys of requests."""
    return [key.split("/", 1)[1].rsplit("/", 2)[0] for key in requests if key[0] != "@"]


def rule(
    name: str,
    flow: Flow,
    messages: Iterable[str],
    on: Iterable[str],
    permission: Literal["allow", "deny"] = "allow",
) -> dict[str, Any]:
    """Return a rule of Zenoh on messages with key expressions; its name is unique."""
    return {
        "id": f"{name} ({flow})",
        "permission": permission,
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(on),
    }


def operator_topics(deployment: Deployment) -> dict[str, tuple[str, ...]]:
    """Return the topics (full names) on which operators may publish, each with its keys."""
    topics = input_topics(deployment, "operator_inputs")
    for name in deployment.external_topics:  # the type may be one that no component here has
        topic = full_name(deployment.robot.name, name)
        topics[topic] = (f"{deployment.domain}{topic}/*/*",)
    for one in ros_topics(deployment) if deployment.ros_names else ():
        if one.target in topics:
            topics[one.source] = (keys.message_key(deployment.domain, one.source, one.message),)
    return topics


def confidential_topics(deployment: Deployment) -> dict[str, tuple[str, ...]]:
    """Return the topics (full names, or what they are) that only `administer` may read, as keys."""
    topics = input_topics(deployment, "confidential_inputs")
    if deployment.has_call_log:  # which has the arguments of requests, such as the tokens of leases
        logs = f"{deployment.robot.name}/{call_log_topic('*')}"
        topics["call logs"] = (f"{deployment.domain}/{logs}/*/*",)
    # The calls of services may have such arguments, too.
    topics["service events"] = (f"{deployment.domain}/**/{SERVICE_EVENT_TOPIC}/*/*",)
    return topics


def input_topics(
    deployment: Deployment, attribute: Literal["operator_inputs", "confidential_inputs"]
) -> dict[str, tuple[str, ...]]:
    """Return the topics (full names) of the inputs that this attribute names, with their keys."""
    topics: dict[str, tuple[str, ...]] = {}
    for member in deployment.members():
        cls = load_plugin(member.spec.plugin)
        ports = ports_of(cls)
        for port in sorted(getattr(cls, attribute)):
            topic = full_name(deployment.robot.name, member.spec.topics.get(port, port))
            kind = type_name(ports[port].interface)
            topics[topic] = (f"{deployment.domain}{topic}/{keys.dds_type(kind)}/*",)
    return topics


def _services(deployment: Deployment) -> dict[str, Role]:
    """Return the services (full names) that a role below `administer` may call."""
    found: dict[str, Role] = {}
    for member in deployment.members():
        cls = load_plugin(member.spec.plugin)
        actions = actions_of(cls)
        for port, role in sorted(cls.service_roles.items()):
            name = full_name(deployment.robot.name, member.spec.topics.get(port, port))
            if port in actions:
                found |= {f"{name}/{part}": role for part in actions[port].services()}
            else:
                found[name] = role
    if deployment.ros_names:
        roles = [(one.name, found.get(one.server)) for one in ros_services(deployment)]
        found |= {name: role for name, role in roles if role is not None}
    return found


def requests_by_role(deployment: Deployment) -> dict[Role, list[str]]:
    """Return the keys of the requests that each role adds to those of the role below it."""
    found: dict[Role, list[str]] = {"view": [], "operate": [], "administer": []}
    main = deployment.main_machine
    roots = [root_name(one, main) for one in deployment.machines] or [ROOT]
    for root in roots:
        found["view"].append(
            keys.control_key(deployment.domain, full_name(deployment.robot.name, root), _RUN)
        )
    nodes = (*roots, *(member.name for member in deployment.members()))
    for node in (full_name(deployment.robot.name, one) for one in nodes):
        found["view"] += [f"{deployment.domain}{node}/{name}/*/*" for name in _VIEWED_SERVICES]
    for service, role in _services(deployment).items():
        found[role].append(f"{deployment.domain}{service}/*/*")
    for member in deployment.members():
        component = full_name(deployment.robot.name, member.name)
        roles = {_VIEWED_BY_ALL: "view", **load_plugin(member.spec.plugin).request_roles}
        for verb, role in sorted(roles.items()):
            found[role].append(keys.control_key(deployment.domain, component, verb))
    return found
