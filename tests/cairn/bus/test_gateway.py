"""Users on the network connect with a password or certificate, and do what their role allows."""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from cairn import LATCHED, RELIABLE, CairnError
from cairn.bus import control, keys
from cairn.bus.codec import Codec, to_plain
from cairn.bus.control import ControlError, ControlServer
from cairn.bus.credentials import Credentials
from cairn.bus.discovery import QueryableWatcher
from cairn.bus.endpoints import socket_path
from cairn.bus.roles import Role
from cairn.bus.session import Gateway, open_client, open_peer
from cairn.bus.type_hash import type_hash
from cairn.bus.zenoh_bus import ZenohBus
from cairn.client import Connection
from cairn.deployment.model import Deployment
from cairn.processes.run_plan import plan_run
from cairn.schemas.cairn_nav_msgs import TeleoperationCommand
from cairn.schemas.geometry_msgs import PoseStamped, Twist, Vector3
from cairn.schemas.message import type_name
from cairn.schemas.nav2_msgs.action import Spin
from cairn.schemas.std_msgs import Header
from cairn.testing.launching import free_port
from tests.cairn.bus.network import Network, Reader, eventually, node
from tests.cairn.bus.ros2 import ros2_node
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes

ROLES: tuple[Role, ...] = ("view", "operate", "administer")
ROBOT = {
    "cairn": 1,
    "external_topics": ["joy"],
    "components": {
        "mobile": {"plugin": "mobile_supervisor"},
        "velocity_gate": {"plugin": "velocity_gate"},
    },
}
GOAL = PoseStamped()
MESSAGE = Codec().encode(GOAL)
GOAL_KEY = keys.message_key(0, "/robot/goal_pose", PoseStamped)
TELEOPERATION_KEY = keys.message_key(0, "/robot/teleoperation", TeleoperationCommand)
COMMAND_KEY = keys.message_key(0, "/robot/cmd_vel", Twist)


class Robot:
    """What the components of a robot declare, and a gateway between it and the network."""

    def __init__(self, folder: Path, bus: dict[str, Any], scheme: str) -> None:
        folder.chmod(0o700)
        self.endpoint = f"{scheme}/127.0.0.1:{free_port()}"
        deployment = Deployment.model_validate({**ROBOT, "bus": {**bus, "listen": [self.endpoint]}})
        self.network = Network()
        gateway = plan_run(deployment).gateway
        assert gateway is not None
        router = socket_path(self.network.endpoint)
        assert router is not None
        self.gateway = gateway.open(router, folder)
        self.bus = self.network.bus()
        robot = self.node = node(self.bus, "/robot/mobile")
        self.goals = Reader(robot, "/robot/goal_pose", PoseStamped, RELIABLE)
        self.teleoperation = Reader(robot, "/robot/teleoperation", TeleoperationCommand, RELIABLE)
        self.commands = Reader(robot, "/robot/cmd_vel", Twist, RELIABLE)
        self.map = robot.advertise("/robot/map", PoseStamped, LATCHED)
        self.map.publish(GOAL)
        self.requests: list[str] = []
        self.server = ControlServer(
            self.bus.session, 0, "/robot/velocity_gate", self._now, self._answer
        )
        assert eventually(lambda: answers(self.gateway))

    def close(self) -> None:
        self.server.close()
        self.gateway.close()
        self.network.close()

    def _now(self, call: Callable[[], None]) -> None:
        call()

    def _answer(self, verb: str, _: Any) -> str:
        self.requests.append(verb)
        return verb


def answers(session: zenoh.Session) -> bool:
    """Return whether the robot answers a query with the priority of messages."""
    key = keys.control_key(0, "/robot/velocity_gate", "parameters")
    replies = session.get(key, payload="{}", timeout=LIMIT_S)
    return any(reply.ok is not None for reply in replies)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot with a user for each role, whose name and password are the role."""
    folder = tmp_path_factory.mktemp("gateway")
    users = {role: {"role": role, "password_file": str(secret(folder, role))} for role in ROLES}
    with closing(Robot(folder, {"users": users}, "tcp")) as robot:
        yield robot


def secret(folder: Path, text: str) -> Path:
    path = folder / f"{text}.password"
    path.touch(mode=0o600)
    path.write_text(f"{text}\n")
    return path


@contextmanager
def joined(robot: Robot, user: Credentials) -> Iterator[zenoh.Session]:
    """The session of a user."""
    session = open_client([robot.endpoint], user)
    try:
        yield session
    finally:
        session.close()


@pytest.fixture(params=ROLES)
def role(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def user(robot: Robot, role: str, tmp_path: Path) -> Iterator[zenoh.Session]:
    with joined(robot, login(tmp_path, role)) as session:
        yield session


def login(folder: Path, name: str, password: str = "") -> Credentials:
    return Credentials(user=name, password_file=str(secret(folder, password or name)))


def passed(session: zenoh.Session) -> None:
    """Wait until all that the session has sent before has reached the robot, or was denied.

    The query has the priority of messages, so it does not overtake them.
    """
    assert answers(session)


def received(robot: Robot, reader: Reader, key: str, last: Any) -> list[Any]:
    """Return what has reached a subscription of the robot, which is then sent a last message."""
    robot.bus.session.put(key, Codec().encode(last))
    found: list[Any] = []

    def complete() -> bool:
        found.extend(reader.pending())
        return last in found

    assert eventually(complete)
    return found[:-1]


def request(session: zenoh.Session, verb: str) -> Any:
    return control.request(session, 0, "/robot/velocity_gate", verb, timeout_s=LIMIT_S)


@pytest.mark.parametrize(
    ("name", "password"), [("", ""), ("view", "wrong"), ("view", "operate"), ("stranger", "view")]
)
def test_wrong_and_missing_passwords_are_refused(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, password: str
) -> None:
    credentials = login(tmp_path, name, password) if name else Credentials()

    with pytest.raises(CairnError, match="Does it accept your user name and password") as caught:
        open_client([robot.endpoint], credentials)
    assert "wrong" not in str(caught.value)
    monkeypatch.setattr("cairn.bus.session._JOIN_TIMEOUT_S", 0.3)
    with pytest.raises(CairnError, match="no router answers"):
        open_peer([robot.endpoint], None, credentials)


def test_every_role_reads_topics_latched_messages_the_graph_and_parameters(
    robot: Robot, user: zenoh.Session
) -> None:
    client = Connection(user, 0, robot.endpoint)
    map_key = keys.message_key(0, "/robot/map", PoseStamped)
    with client.listen(map_key, latched=True) as samples:
        assert samples.get(timeout=LIMIT_S).payload.to_bytes() == MESSAGE
        robot.map.publish(GOAL)
        assert samples.get(timeout=LIMIT_S).payload.to_bytes() == MESSAGE

    assert "/robot/mobile" in client.nodes()
    assert request(user, "parameters") == "parameters"


def test_only_operators_and_administrators_give_goals(
    robot: Robot, user: zenoh.Session, role: str
) -> None:
    user.put(GOAL_KEY, MESSAGE)
    passed(user)

    goals = received(robot, robot.goals, GOAL_KEY, PoseStamped(header=Header(frame_id="last")))
    assert goals == ([] if role == "view" else [GOAL])
    if role == "view":
        with pytest.raises(ControlError, match="no reply to renew_lease"):
            request(user, "renew_lease")
    else:
        assert request(user, "renew_lease") == "renew_lease"


def test_only_administrators_publish_commands_and_change_components(
    robot: Robot, user: zenoh.Session, role: str
) -> None:
    user.put(COMMAND_KEY, Codec().encode(Twist()))
    for verb in ("deactivate", "set_parameters", "load"):
        robot.requests.clear()
        if role == "administer":
            assert request(user, verb) == verb
        else:
            with pytest.raises(ControlError, match=f"no reply to {verb}"):
                request(user, verb)
            assert robot.requests == []
    passed(user)

    commands = received(robot, robot.commands, COMMAND_KEY, Twist(linear=Vector3(x=1.0)))
    assert commands == ([Twist()] if role == "administer" else [])


def test_only_administrators_read_the_lease_in_the_commands_of_another_operator(
    robot: Robot, user: zenoh.Session, role: str, tmp_path: Path
) -> None:
    command = Codec().encode(TeleoperationCommand(lease=4711))
    received: list[bytes] = []
    subscriber: Any = user.declare_subscriber(
        "0/robot/**", lambda sample: received.append(sample.payload.to_bytes())
    )
    passed(user)
    with joined(robot, login(tmp_path, "operate")) as anna:
        anna.put(TELEOPERATION_KEY, command)
        anna.put(keys.message_key(0, "/robot/joy", PoseStamped), MESSAGE)

        assert eventually(lambda: MESSAGE in received)
    assert (command in received) == (role == "administer")
    subscriber.undeclare()
    assert eventually(lambda: TeleoperationCommand(lease=4711) in robot.teleoperation.pending())


def test_only_administrators_read_the_calls_of_services(
    robot: Robot, user: zenoh.Session, role: str
) -> None:
    received: list[str] = []
    subscriber: Any = user.declare_subscriber(
        "0/robot/**", lambda sample: received.append(str(sample.key_expr))
    )
    events = "/robot/mobile/spin/_action/send_goal/_service_event"
    contents = robot.node.advertise(events, Spin.SendGoal.Event, RELIABLE)
    joy = robot.node.advertise("/robot/joy", PoseStamped, RELIABLE)
    passed(user)

    def published() -> bool:
        contents.publish(Spin.SendGoal.Event())
        joy.publish(GOAL)
        return any("/joy/" in key for key in received)

    assert eventually(published)
    passed(user)
    assert any(events[1:] in key for key in received) == (role == "administer")
    contents.close()
    joy.close()
    subscriber.undeclare()


def test_only_administrators_imitate_components(
    robot: Robot, user: zenoh.Session, role: str
) -> None:
    fake = keys.token_key(
        keys.EndpointEntity(
            keys.NodeEntity(0, "ab", 0, f"/robot/fake_{role}"),
            1, "MP", "/robot/cmd_vel", "geometry_msgs/msg/Twist", type_hash(Twist), RELIABLE,
        )
    )  # fmt: skip
    token = user.liveliness().declare_token(fake)
    key = keys.control_key(0, f"/robot/{role}")
    queryable: Any = user.declare_queryable(key, lambda query: query.reply(key, b"{}"))
    passed(user)

    def is_announced() -> bool:
        known = robot.bus.session.liveliness().get(keys.tokens_pattern(0), timeout=LIMIT_S)
        return any(str(one.ok.key_expr) == fake for one in known if one.ok is not None)

    seen = eventually(is_announced) if role == "administer" else is_announced()
    with QueryableWatcher(robot.bus.session, key) as watcher:
        matches = watcher.wait(LIMIT_S if role == "administer" else 0.0)
    assert (seen, matches) == ((True, True) if role == "administer" else (False, False))
    queryable.undeclare()
    token.undeclare()


def test_operator_that_is_a_ros2_node_announces_its_publisher_of_goals(
    robot: Robot, tmp_path: Path
) -> None:
    """With a session as rmw_zenoh has it: a peer, which publishes with a cache."""
    credentials = login(tmp_path, "operate")
    with closing(ZenohBus(open_peer([robot.endpoint], None, credentials))) as outside:
        publisher = node(outside, "/rviz").advertise("/robot/goal_pose", PoseStamped, LATCHED)
        publisher.publish(GOAL)

        assert eventually(lambda: GOAL in robot.goals.pending())
        assert eventually(lambda: "/robot/goal_pose" in topics_of(robot, "/rviz"))


def topics_of(robot: Robot, name: str) -> list[str]:
    """Return the topics that a node publishes, as a command on the robot sees them."""
    graph = robot.network.graph()
    ends = [entity for entity in graph if isinstance(entity, keys.EndpointEntity)]
    return [end.topic for end in ends if end.node.name == name and end.kind == "MP"]


def test_local_processes_and_commands_need_no_password(robot: Robot) -> None:
    other = robot.network.bus()
    assert other.wait_for_peers(LIMIT_S) == []

    assert request(other.session, "deactivate") == "deactivate"
    assert "/robot/mobile" in {one.name for one in robot.network.graph() if hasattr(one, "name")}


def test_processes_of_a_deployment_that_joins_with_a_password_link_to_each_other(
    robot: Robot, tmp_path: Path
) -> None:
    user = login(tmp_path, "administer")
    sockets = Path(tempfile.mkdtemp(prefix="cairn-test-"))
    first, second = (
        ZenohBus(open_peer([robot.endpoint], sockets / f"{name}.sock", user)) for name in "ab"
    )
    with closing(first), closing(second):
        assert first.wait_for_peers(LIMIT_S) == []
        assert str(second.session.info.zid()) in map(str, first.session.info.peers_zid())
        assert not list(sockets.glob("*.users"))
    shutil.rmtree(sockets)


def openssl(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


def certificates(folder: Path) -> None:
    """Make an authority, and certificates for the robot and for clients it knows and does not."""
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2")
    for authority in ("ca", "other"):
        openssl(
            folder, "req", "-x509", *curve, "-keyout", f"{authority}.key", "-out",
            f"{authority}.pem", "-subj", f"/CN={authority}",
        )  # fmt: skip
    for name, authority in (("robot", "ca"), ("tablet", "ca"), ("guest", "ca"), ("rogue", "other")):
        openssl(
            folder, "req", *curve, "-keyout", f"{name}.key", "-out", f"{name}.csr",
            "-subj", f"/CN={name}",
        )  # fmt: skip
        (folder / "names").write_text("subjectAltName=IP:127.0.0.1\n")
        openssl(
            folder, "x509", "-req", "-in", f"{name}.csr", "-CA", f"{authority}.pem", "-CAkey",
            f"{authority}.key", "-CAcreateserial", "-days", "2", "-out", f"{name}.pem",
            "-extfile", "names",
        )  # fmt: skip


@pytest.fixture(scope="module")
def keys_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with certificates and their keys."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificates")
    folder = tmp_path_factory.mktemp("certificates")
    certificates(folder)
    return folder


@pytest.fixture(scope="module")
def certified(keys_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot that knows its clients by certificates."""
    tls = {
        "certificate": str(keys_folder / "robot.pem"),
        "key": str(keys_folder / "robot.key"),
        "ca": str(keys_folder / "ca.pem"),
        "client_certificates": True,
        "certificate_roles": {"tablet": "operate"},
    }
    with closing(Robot(tmp_path_factory.mktemp("certified"), {"tls": tls}, "tls")) as robot:
        yield robot


def test_client_is_known_by_its_certificate(certified: Robot, keys_folder: Path) -> None:
    def known_by(name: str) -> Credentials:
        return Credentials(
            ca=str(keys_folder / "ca.pem"),
            certificate=str(keys_folder / f"{name}.pem"),
            key=str(keys_folder / f"{name}.key"),
        )

    with joined(certified, known_by("tablet")) as tablet:
        assert request(tablet, "renew_lease") == "renew_lease"
        with pytest.raises(ControlError, match="no reply to deactivate"):
            request(tablet, "deactivate")
    with joined(certified, known_by("guest")) as guest:  # signed, but without a role
        with pytest.raises(ControlError, match="no reply to parameters"):
            request(guest, "parameters")
        assert Connection(guest, 0, certified.endpoint).nodes() == []
    for credentials in (known_by("rogue"), Credentials(ca=str(keys_folder / "ca.pem"))):
        with pytest.raises(CairnError, match="no router answers"):
            open_client([certified.endpoint], credentials)


def test_ros2_node_connects_with_the_session_settings_of_the_documentation(
    certified: Robot, keys_folder: Path, tmp_path: Path
) -> None:
    page = Path(__file__).parents[3] / "docs" / "how-to" / "connect.md"
    (shown,) = re.findall("ZENOH_CONFIG_OVERRIDE='(.*)'", page.read_text(encoding="utf-8"))
    settings = (
        shown.replace("tls/robot.example:7447", certified.endpoint)
        .replace('"ca.pem"', f'"{keys_folder}/ca.pem"')
        .replace("rviz.", f"{keys_folder}/tablet.")
    )
    override = {"ZENOH_CONFIG_OVERRIDE": settings}
    with ros2_node(0, tmp_path, (PoseStamped, Twist), override) as ros2:
        for topic, kind in (("goal_pose", PoseStamped), ("cmd_vel", Twist)):
            ros2.request("advertise", topic=f"/robot/{topic}", type=type_name(kind), node="rviz")
        name = type_name(PoseStamped)
        ros2.request("subscribe", topic="/robot/map", type=name, node="rviz")
        assert eventually(lambda: ros2.request("has_subscribers", topic="/robot/goal_pose"))

        ros2.request("publish", topic="/robot/cmd_vel", value=to_plain(Twist()))
        ros2.request("publish", topic="/robot/goal_pose", value=to_plain(GOAL))

        assert eventually(lambda: GOAL in certified.goals.pending())
        moved = Twist(linear=Vector3(x=1.0))
        assert received(certified, certified.commands, COMMAND_KEY, moved) == []
        assert eventually(lambda: certified.map.has_subscribers)
        certified.map.publish(GOAL)
        assert ros2.request("receive", topic="/robot/map")["pose"] == to_plain(GOAL.pose)


def test_endpoint_in_use_is_reported(robot: Robot, tmp_path: Path) -> None:
    gateway = Gateway((robot.endpoint,), {"enabled": False}, {})
    router = socket_path(robot.network.endpoint)
    assert router is not None

    reason = f"cannot listen on {robot.endpoint}: an address is in use .*correct bus.listen"
    with pytest.raises(CairnError, match=reason):
        gateway.open(router, tmp_path)
