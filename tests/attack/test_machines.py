"""A machine of the robot that was taken over tries what its components do not do.

It has a valid certificate and a router of its own, linked to that of the first machine.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from secrets import token_hex
from typing import Any, Literal

import pytest
import zenoh

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.endpoints import UNIX
from cairn.bus.keys import EndpointEntity, NodeEntity
from cairn.bus.session import MachineLinks, open_peer, open_router, peer_socket
from cairn.bus.type_hash import type_hash
from cairn.deployment.load import load_deployment
from cairn.deployment.machine_access import machine_access
from cairn.deployment.machines import components_by_machine
from cairn.deployment.model import Deployment
from cairn.deployment.plugins import load_plugin
from cairn.deployment.shipped import FOLDER
from cairn.processes.certified_router import machine_links
from cairn.processes.machine_identity import machine_identity
from cairn.runtime.ports import actions_of, ports_of
from cairn.schemas.cairn_msgs import ComponentStatus, MachineStatus
from cairn.schemas.message import type_name
from cairn.security.authority import Authority, AuthorityMember
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import free_port
from tests.attack.conftest import Cases
from tests.cairn.bus.network import eventually
from tests.cairn.security.computers import days_ago
from tests.patience import LIMIT_S

_MARK = "end_of_attack_"
_VERBS = ("load", "unload", "restart", "hold", "set_parameters", "parameters", "configure", "why")
_REMOTE = ("load", "unload", "hold")
"""What a supervisor requests of the root on the machine of its child."""

_ROLES = ("", "view", "operate", "administer")
in_each_role = pytest.mark.parametrize("robot", _ROLES, indirect=True)
"""For tests of what a machine may do, with each role that the deployment may give it."""

_OVERLAY = """
machines:
  base: {{address: 127.0.0.1, port: {base}}}
  brain: {{address: 127.0.0.1, port: {brain}{role}}}
components:
  mobile_supervisor:
    children:
      automove:
        machine: brain
        children:
          motion_control: {{machine: base}}
          path_planner: {{machine: base, fallback: {{}}}}
  vision_supervisor: {{machine: brain}}
  guide: {{plugin: "tests.attack.guide:Guide", machine: brain}}
"""


@dataclass
class Robot:
    """The router of machine `base`, what a component there receives, and the attacker's session."""

    deployment: Deployment
    links: MachineLinks
    folder: Path
    local: zenoh.Session
    received: list[str]
    tokens: set[str]

    @property
    def role(self) -> str:
        """That of machine `brain`."""
        return self.deployment.machines["brain"].role or ""

    @property
    def own(self) -> set[str]:
        """The nodes of machine `brain`."""
        components = components_by_machine(self.deployment)["brain"]
        return {*components, "root_brain", "cairn_up_brain"}

    def attacker(self, identity: str = "brain", authority: Path | None = None) -> zenoh.Session:
        """Open a router with a certificate, linked to that of `base`."""
        own = (authority or self.folder) / "identities" / identity
        config = zenoh.Config()
        settings: dict[str, Any] = {
            "mode": "router",
            "listen/endpoints": [],  # by default it listens on all addresses
            "connect/endpoints": [self.links.listen],
            "connect/exit_on_failure": False,
            "scouting/multicast/enabled": False,
            "transport/link/tls": {
                "root_ca_certificate": self.links.ca,
                "connect_certificate": f"{own}.pem",
                "connect_private_key": f"{own}.key",
                "enable_mtls": True,
            },
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory, request: Any) -> Iterator[Robot]:
    folder: Path = tmp_path_factory.mktemp("machines")
    overlay = folder / "machines.yaml"
    role = f", role: {request.param}" if getattr(request, "param", "") else ""
    overlay.write_text(_OVERLAY.format(base=free_port(), brain=free_port(), role=role))
    deployment = load_deployment(FOLDER / "sim.yaml", [overlay])
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv(VARIABLE, str(folder / "security"))
        members = [AuthorityMember(name, None, ("127.0.0.1",)) for name in ("base", "brain", "arm")]
        Authority.create(
            RobotFolder.of("robot"), [*members, AuthorityMember("alice", "administer", ())]
        )
        links = machine_links(deployment, "base", machine_access(deployment, "base"))
        socket = folder / "bus" / "router.sock"
        stack.enter_context(closing(open_router(socket, links=links)))
        local = stack.enter_context(
            closing(open_peer([UNIX + str(socket)], peer_socket(socket.parent, "peer")))
        )
        received: list[str] = []
        tokens: set[str] = set()
        everything = (f"{deployment.domain}/**", f"{deployment.domain}/**/@adv/**", "@cairn/**")
        for key in everything:
            local.declare_subscriber(key, lambda sample: received.append(str(sample.key_expr)))
        local.liveliness().declare_subscriber(
            f"{keys.TOKENS}/**", lambda sample: tokens.add(str(sample.key_expr)), history=True
        )
        yield Robot(deployment, links, RobotFolder.of("robot").path, local, received, tokens)


def _reply(key: str, query: zenoh.Query) -> None:
    query.reply(key, b"forged")


def keys_of(
    deployment: Deployment, direction: Literal["in", "out"], attribute: str = ""
) -> dict[str, set[str]]:
    """Return the key of every topic that components publish or read, with the components.

    With an attribute of their classes, return those of the inputs that it names.
    """
    found: dict[str, set[str]] = {}
    for member in deployment.members():
        cls = load_plugin(member.spec.plugin)
        ports = [one for name, one in ports_of(cls).items()
                 if not attribute or name in getattr(cls, attribute)]  # fmt: skip
        ports += [
            part.declare(f"{name}/{below}", part.interface)
            for name, action in actions_of(cls).items()
            for below, part in action.topics().items()
            if not attribute
        ]
        for port in ports:
            if port.direction == direction:
                topic = full_name(
                    deployment.robot.name, member.spec.topics.get(port.name, port.name)
                )
                topic = full_name(deployment.robot.name, topic)
                key = keys.message_key(deployment.domain, topic, port.interface)
                found.setdefault(key, set()).add(member.name)
    return found


def own_mark(robot: Robot) -> str:
    """Return a new key on which machine `brain` may publish: below the name of its component."""
    return f"{robot.deployment.domain}/robot/automove/{_MARK}{token_hex(4)}/x/y"


def shuffled(found: set[str]) -> list[str]:
    """Return key expressions in an order that is the same in each run."""
    order = sorted(found)
    random.Random(1).shuffle(order)
    return order


def await_mark(robot: Robot, attacker: zenoh.Session) -> None:
    """Wait until everything that the attacker has sent before has been handled."""
    mark = own_mark(robot)

    def arrived() -> bool:
        attacker.put(mark, b"")
        return mark in robot.received

    eventually(arrived)


@in_each_role
def test_machine_publishes_what_its_components_do_and_its_role_allows(
    robot: Robot, cases: Cases
) -> None:
    domain = robot.deployment.domain
    topics = keys_of(robot.deployment, "out")
    operated = keys_of(robot.deployment, "in", "operator_inputs")
    status = keys.message_key(domain, "/robot/root_brain/machine_status", MachineStatus)
    needed = {status} | {key for key, names in topics.items() if names & robot.own}
    if robot.role in ("operate", "administer"):
        needed |= operated.keys()
    others = [one.name for one in robot.deployment.members() if one.name not in robot.own]
    forbidden = {key for key in {**topics, **operated} if key not in needed}
    forbidden |= {f"{domain}/robot/{name}/call_log/x/y" for name in others}
    forbidden |= {status.replace("root_brain", name) for name in ("root", "root_arm", "*")}
    forbidden |= {status.replace("/root_brain", ""), f"{domain}/**"}
    forbidden |= {f"{domain}/robot/{name}/x/y" for name in robot.own}  # topics of these names
    forbidden |= {f"{domain}/{name}/x/y" for name in ("tf", "scan", "cmd_vel", "other/scan")}
    forbidden |= {f"{domain + 1}{key[key.index('/') :]}" for key in needed}
    forbidden |= {f"{key}/@adv/pub/1/1" for key in forbidden}
    assert len(needed) >= 5
    with closing(robot.attacker()) as attacker:
        await_mark(robot, attacker)
        robot.received.clear()
        order = shuffled(forbidden | needed)
        for key in order:
            attacker.put(key, b"forged")
        await_mark(robot, attacker)
    let_in = {key for key in robot.received if _MARK not in key}
    assert let_in == needed
    cases(order)


@in_each_role
def test_machine_reads_what_its_components_do_and_its_role_allows(
    robot: Robot, cases: Cases
) -> None:
    domain = robot.deployment.domain
    published, read = keys_of(robot.deployment, "out"), keys_of(robot.deployment, "in")
    statuses = {
        keys.message_key(domain, "/robot/component_status", ComponentStatus),
        keys.message_key(domain, "/robot/root/machine_status", MachineStatus),
    }
    needed = statuses | {key for key, names in read.items() if names & robot.own}
    everything = needed | published.keys() | read.keys()
    everything |= {f"{domain}/{name}/x/y" for name in ("rosout", "tf", "other/scan")}
    secret = {f"{domain}/robot/{name}/_service_event/x/y" for name in ("ring", "localizer/x")}
    secret |= keys_of(robot.deployment, "in", "confidential_inputs").keys() - needed
    elsewhere = {f"{domain + 1}/robot/scan/x/y"}
    if robot.role:
        needed |= everything - secret
    if robot.role == "administer":
        needed |= secret
    order = shuffled(everything | secret | elsewhere)
    assert 10 <= len(statuses | needed) <= len(order) - (1 if robot.role == "administer" else 2)
    received: set[str] = set()

    def all_arrive() -> bool:
        for key in order:  # again, until the subscriptions are known
            robot.local.put(key, b"", congestion_control=zenoh.CongestionControl.BLOCK)
        return needed <= received

    with closing(robot.attacker()) as attacker:
        wide = (f"{domain}/**", f"{domain}/robot/*/**", "**", f"{domain + 1}/**")
        for key in (*wide, *order):
            attacker.declare_subscriber(key, lambda sample: received.add(str(sample.key_expr)))
        eventually(all_arrive)
        received.clear()
        eventually(all_arrive)  # what was sent before has arrived, or never will
    assert received == needed
    cases(order)


@in_each_role
def test_machine_requests_what_its_components_do_and_its_role_allows(
    robot: Robot, cases: Cases
) -> None:
    domain, deployment = robot.deployment.domain, robot.deployment
    others = [one.name for one in deployment.members() if one.name not in robot.own]

    def control(name: str, *verbs: str) -> set[str]:
        return {keys.control_key(domain, f"/robot/{name}", verb) for verb in verbs}

    needed = control("root", *_REMOTE)
    action = f"{domain}/robot/compute_path_to_pose/_action"
    needed |= {f"{action}/{part}/x/y" for part in ("send_goal", "cancel_goal", "get_result")}
    needed |= {f"{domain}/robot/ring/x/y"}
    read = {key for key, names in keys_of(deployment, "in").items() if names & robot.own}
    needed |= {f"{key}/@adv/pub/1/1" for key in read}
    viewed = {f"{key}/@adv/pub/1/1" for key in keys_of(deployment, "in").keys() - read}
    viewed |= {f"{domain}/robot/{name}/get_parameters/x/y" for name in (*others, "root")}
    viewed |= control("root", "run").union(*(control(name, "parameters") for name in others))
    operated = control("velocity_gate", "stop", "release_stop", "acquire_lease")
    administered = {f"{domain}/robot/{name}/set_parameters/x/y" for name in others}
    administered |= control("velocity_gate", "take_over_lease")
    administered |= set().union(*(control(name, *_VERBS) for name in (*others, "root")))
    administered |= {f"{domain}/robot/x/y/z", f"{domain}/tf_static/x/y"}
    never = {f"{domain + 1}/robot/ring/x/y", f"@cairn/{domain + 1}/component/robot/root/load"}
    for role, more in zip(_ROLES[1:], (viewed, operated, administered), strict=True):
        if _ROLES.index(robot.role) >= _ROLES.index(role):
            needed |= more
    order = shuffled(needed | viewed | operated | administered | never)
    answers = [robot.local.declare_queryable(key, partial(_reply, key)) for key in order]
    with closing(robot.attacker()) as attacker:
        eventually(lambda: bool(list(attacker.get(next(iter(control("root", "load")))))))
        waiting = {key: attacker.get(key, timeout=LIMIT_S) for key in order}
        answered = {key for key, replies in waiting.items() if any(one.ok for one in replies)}
    del answers
    assert answered == needed
    cases(order)


def test_machine_answers_for_its_own_components_only(robot: Robot, cases: Cases) -> None:
    domain = robot.deployment.domain
    names = [one.name for one in robot.deployment.members()]
    requests = [
        keys.control_key(domain, f"/robot/{name}", verb)
        for name in (*names, "root", "root_brain")
        for verb in _VERBS
    ]
    requests += [f"{domain}/robot/{name}/get_state/x/y" for name in names]
    requests += [f"{domain}/robot/ring/x/y", f"{domain}/robot/other/y/z"]
    requests += [f"{domain}/robot/compute_path_to_pose/{rest}" for rest in ("x/y", "a/b/x/y")]
    # Also by the fallback of its server, which runs on this machine.
    served = {f"{domain}/robot/compute_path_to_pose/_action/send_goal/x/y"}
    requests += served
    with closing(robot.attacker()) as attacker:
        for key in requests:
            attacker.declare_queryable(key, partial(_reply, key), complete=True)
        await_mark(robot, attacker)
        answered = {
            key
            for key in requests
            if any(reply.ok for reply in robot.local.get(key, timeout=LIMIT_S))
        }
    assert answered == served | {key for key in requests if {*key.split("/")} & robot.own}
    cases(requests)


def test_machine_announces_its_own_nodes_only(robot: Robot, cases: Cases) -> None:
    domain = robot.deployment.domain
    names = [one.name for one in robot.deployment.members()]
    nodes = [NodeEntity(domain, "1", 1, f"/robot/{name}") for name in (*names, "root", "stranger")]
    nodes += [NodeEntity(domain, "1", 1, f"/other/{name}") for name in names[:3]]
    nodes += [NodeEntity(domain + 1, "1", 1, f"/robot/{name}") for name in robot.own]
    plugin = ports_of(load_plugin("simulated_scanner"))["scan"]
    entities: list[NodeEntity | EndpointEntity] = [*nodes]
    for node in nodes:
        entities += [
            EndpointEntity(
                node, 2, kind, "/robot/scan", type_name(plugin.interface),
                type_hash(plugin.interface), plugin.qos,
            )
            for kind in ("MP", "MS", "SS", "SC")
        ]  # fmt: skip
    with closing(robot.attacker()) as attacker:
        tokens = {keys.token_key(one): one for one in entities}
        kept = [attacker.liveliness().declare_token(key) for key in tokens]
        await_mark(robot, attacker)
        own = {
            key
            for key, one in tokens.items()
            if (node := one if isinstance(one, NodeEntity) else one.node).domain == domain
            and node.name.startswith("/robot/")
            and node.name.rpartition("/")[2] in robot.own
        }
        eventually(lambda: own <= robot.tokens)
        assert robot.tokens & tokens.keys() == own
        del kept
    cases(list(tokens))


def test_others_with_a_certificate_of_the_robot_may_do_nothing(robot: Robot, cases: Cases) -> None:
    """An operator, even one who administers, and a machine that the deployment does not have."""
    mark = own_mark(robot)
    verbs = [keys.control_key(robot.deployment.domain, "/robot/root", verb) for verb in _REMOTE]
    answers = [robot.local.declare_queryable(key, partial(_reply, key)) for key in verbs]
    with closing(robot.attacker()) as machine:
        await_mark(robot, machine)
        assert all(list(machine.get(key, timeout=LIMIT_S)) for key in verbs)
    for identity in ("alice", "arm"):
        with closing(robot.attacker(identity)) as attacker:
            for _ in range(20):
                attacker.put(mark, b"")
            assert not [key for key in verbs if list(attacker.get(key, timeout=0.2))]
    with closing(robot.attacker()) as machine:
        await_mark(robot, machine)
    assert mark not in robot.received
    del answers
    cases([*verbs, *verbs, mark, mark])


@pytest.mark.parametrize("kind", ["other authority", "expired", "replaced"])
def test_certificates_that_are_not_in_force_open_no_link(
    robot: Robot, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "replaced":
        names = machine_identity("robot", "brain").common_names
        renewed = Authority(RobotFolder.of("robot")).renew("brain", grace_s=0)
        assert renewed.common_name not in names["brain"]
        now = machine_identity("robot", "brain").common_names
        assert now["brain"] == (renewed.common_name,)
        authority = robot.folder  # its new certificate is not in force at this router
    else:
        monkeypatch.setenv(VARIABLE, str(tmp_path / "security"))
        members = [AuthorityMember("brain", None, ("127.0.0.1",))]
        with days_ago(10):
            own = Authority.create(RobotFolder.of("robot"), members, days=1)
        authority = own.folder.path
        if kind == "expired":
            (authority / "ca.pem").write_bytes(Path(robot.links.ca).read_bytes())
    mark = own_mark(robot)
    with closing(robot.attacker(authority=authority)) as attacker:
        for _ in range(20):
            attacker.put(mark, b"")
        assert not list(attacker.get(keys.control_key(0, "/robot/root", "run"), timeout=0.5))
    assert mark not in robot.received
