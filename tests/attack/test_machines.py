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
from typing import Any

import pytest
import zenoh

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.endpoints import UNIX
from cairn.bus.keys import EndpointEntity, NodeEntity
from cairn.bus.session import MachineLinks, open_peer, open_router, peer_socket
from cairn.bus.type_hash import type_hash
from cairn.deployment.access_control import machine_access
from cairn.deployment.load import load_deployment
from cairn.deployment.machines import components_by_machine
from cairn.deployment.model import Deployment
from cairn.deployment.plugins import load_plugin
from cairn.deployment.shipped import FOLDER
from cairn.placement.machine_identity import machine_identity
from cairn.placement.machine_router import machine_links
from cairn.runtime.ports import ports_of
from cairn.schemas.message import type_name
from cairn.security.authority import Authority, Member
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.testing.launching import free_port
from tests.attack.conftest import Cases
from tests.cairn.bus.network import eventually
from tests.cairn.security.computers import days_ago
from tests.patience import LIMIT_S

_MARK = "mark"
_VERBS = ("load", "unload", "restart", "hold", "set_parameters", "parameters", "configure", "why")
_OWN = ("localizer", "vision_supervisor", "object_recognizer", "root_brain", "cairn_up_brain")


@dataclass
class Robot:
    """The router of machine `base`, what a component there receives, and the attacker's session."""

    deployment: Deployment
    links: MachineLinks
    folder: Path
    local: zenoh.Session
    received: list[str]
    tokens: set[str]

    def attacker(self, identity: str = "brain", authority: Path | None = None) -> zenoh.Session:
        """Open a router with a certificate, linked to that of `base`."""
        own = (authority or self.folder) / "identities" / identity
        config = zenoh.Config()
        settings: dict[str, Any] = {
            "mode": "router",
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
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder: Path = tmp_path_factory.mktemp("machines")
    overlay = folder / "machines.yaml"
    overlay.write_text(
        f"machines: {{base: {{address: 127.0.0.1, port: {free_port()}}}, "
        f"brain: {{address: 127.0.0.1, port: {free_port()}}}}}\n"
        "components:\n"
        "  mobile_supervisor: {children: {automove: {children: {localizer: {machine: brain}}}}}\n"
        "  vision_supervisor: {machine: brain}\n"
    )
    deployment = load_deployment(FOLDER / "sim.yaml", [overlay])
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv(VARIABLE, str(folder / "security"))
        members = [Member(name, None, ("127.0.0.1",)) for name in ("base", "brain", "arm")]
        Authority.create(RobotFolder.of("robot"), [*members, Member("alice", "administer", ())])
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


def publications(deployment: Deployment) -> dict[str, set[str]]:
    """Return the key of every topic that components publish, with the components."""
    found: dict[str, set[str]] = {}
    for member in deployment.members():
        for port in ports_of(load_plugin(member.spec.plugin)).values():
            if port.direction == "out":
                topic = full_name(deployment.robot, member.spec.topics.get(port.name, port.name))
                key = keys.message_key(deployment.domain, topic, port.message)
                found.setdefault(key, set()).add(member.name)
    return found


def own_mark(robot: Robot) -> str:
    """Return a new key on which machine `brain` may publish: below the name of its component."""
    return f"{robot.deployment.domain}/robot/localizer/{_MARK}{token_hex(4)}/x/y"


def await_mark(robot: Robot, attacker: zenoh.Session) -> None:
    """Wait until everything that the attacker has sent before has been handled."""
    mark = own_mark(robot)

    def arrived() -> bool:
        attacker.put(mark, b"")
        return mark in robot.received

    eventually(arrived)


def test_machine_publishes_what_its_components_do_and_nothing_else(
    robot: Robot, cases: Cases
) -> None:
    domain = robot.deployment.domain
    on_brain = set(components_by_machine(robot.deployment)["brain"])
    topics = publications(robot.deployment)
    needed = {key for key, names in topics.items() if names & on_brain}
    forbidden = topics.keys() - needed
    others = [one.name for one in robot.deployment.members() if one.name not in on_brain]
    forbidden |= {f"{domain}/robot/{name}/call_log/x/y" for name in others}
    forbidden |= {f"{domain}/{name}/x/y" for name in ("tf", "scan", "cmd_vel", "other/scan")}
    forbidden |= {f"{domain + 1}{key[key.index('/') :]}" for key in needed}
    forbidden |= {f"{key}/@adv/pub/1/1" for key in forbidden}
    assert len(needed) >= 5
    with closing(robot.attacker()) as attacker:
        await_mark(robot, attacker)
        robot.received.clear()
        order = sorted(forbidden | needed)
        random.Random(1).shuffle(order)
        for key in order:
            attacker.put(key, b"forged")
        await_mark(robot, attacker)
    let_in = {key for key in robot.received if _MARK not in key}
    assert let_in == needed
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
    requests += [f"{domain}/robot/navigate_to_pose/_action/send_goal/x/y", f"{domain}/robot/x/y/z"]
    with closing(robot.attacker()) as attacker:
        for key in requests:
            attacker.declare_queryable(key, partial(_reply, key), complete=True)
        await_mark(robot, attacker)
        answered = {
            key
            for key in requests
            if any(reply.ok for reply in robot.local.get(key, timeout=LIMIT_S))
        }
    assert answered == {key for key in requests if {*key.split("/")} & {*_OWN}}
    cases(requests)


def test_machine_announces_its_own_nodes_only(robot: Robot, cases: Cases) -> None:
    domain = robot.deployment.domain
    names = [one.name for one in robot.deployment.members()]
    nodes = [NodeEntity(domain, "1", 1, f"/robot/{name}") for name in (*names, "root", "stranger")]
    nodes += [NodeEntity(domain, "1", 1, f"/other/{name}") for name in names[:3]]
    nodes += [NodeEntity(domain + 1, "1", 1, f"/robot/{name}") for name in _OWN]
    plugin = ports_of(load_plugin("simulated_scanner"))["scan"]
    entities: list[NodeEntity | EndpointEntity] = [*nodes]
    for node in nodes:
        entities += [
            EndpointEntity(
                node, 2, kind, "/robot/scan", type_name(plugin.message),
                type_hash(plugin.message), plugin.qos,
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
            and node.name.rpartition("/")[2] in _OWN
        }
        eventually(lambda: own <= robot.tokens)
        assert robot.tokens & tokens.keys() == own
        del kept
    cases(list(tokens))


def test_others_with_a_certificate_of_the_robot_may_do_nothing(robot: Robot, cases: Cases) -> None:
    """An operator, even one who administers, and a machine that the deployment does not have."""
    mark = own_mark(robot)
    verbs = [keys.control_key(robot.deployment.domain, "/robot/root", verb) for verb in _VERBS]
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
        members = [Member("brain", None, ("127.0.0.1",))]
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
