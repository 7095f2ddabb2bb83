"""A peer without rights forges, repeats and damages messages, and pretends to be others."""

from __future__ import annotations

import itertools
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from typing import Any, Final

import pytest
import zenoh

from cairn import RELIABLE, Qos
from cairn.bus import keys
from cairn.bus.exclusive import PROOF_BYTES, Exclusive, Signer
from cairn.bus.keys import Attachment, EndpointEntity, NodeEntity
from cairn.bus.session import session_id
from cairn.bus.type_hash import type_hash
from cairn.schemas.cairn_msgs import ComponentStatus, PortStatus
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.message import type_name
from cairn.schemas.std_msgs import Header, String
from tests.attack.conftest import Cases
from tests.attack.inputs import (
    CODEC,
    DAMAGES,
    Topic,
    components,
    invalid,
    topics,
    valid,
)
from tests.attack.robot import MOST_MEMORY_MB, AttackedRobot
from tests.commands import cairn

AHEAD: Final = CODEC.encode(Twist(linear=Vector3(x=0.4)))
BLOCK: Final = zenoh.CongestionControl.BLOCK
_PERIOD_S: Final = 0.05

COMMANDS: Final = ("cmd_vel", "navigator_cmd_vel")
"""The topics by which the robot moves."""

assert all(topics()[name].exclusive for name in COMMANDS)
INVALID: Final = {
    damage: [
        topic for topic in topics().values() if not topic.exclusive and damage in invalid(topic)
    ]
    for damage in DAMAGES
}
"""The topics on which messages with each damage are sent; exclusive readers refuse them unread."""

RESTARTED: Final = "object_recognizer"
"""A component whose restart is timed."""

LARGE: Final = ("scan", "map", "goal_pose", "cmd_vel")
"""Topics on which many megabytes are sent."""


class Peer:
    """A program of any user of this computer, which knows all but the secret of the run."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.gid = secrets.token_bytes(16)
        self._numbers = itertools.count(1)

    def attachment(self, **changed: Any) -> Attachment:
        """Return the attachment of its next message."""
        return Attachment(next(self._numbers), time.time_ns(), self.gid)._replace(**changed)

    def put(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        """Send a message."""
        self.session.put(key, payload, attachment=attachment, congestion_control=BLOCK)

    def put_until(
        self,
        robot: AttackedRobot,
        messages: Mapping[Topic, Iterator[tuple[bytes, bytes | None]]],
        holds: Callable[[PortStatus, PortStatus], bool],
    ) -> None:
        """Send on topics at 20 Hz until `holds(before, now)` for all readers; fail after 5 s."""
        end = threading.Event()

        def send() -> None:
            while not end.is_set():
                for topic, following in messages.items():
                    self.put(topic.key, *next(following))
                end.wait(_PERIOD_S)

        sender = threading.Thread(target=send)
        sender.start()
        try:
            robot.await_counts(messages, holds)
        finally:
            end.set()
            sender.join()

    def announce(self, name: str, topic: Topic, message: type[Any], qos: Qos = RELIABLE) -> Any:
        """Announce a publisher as that of a node of any name; it takes its identity."""
        zid = str(self.session.info.zid())
        number = next(self._numbers)
        entity = EndpointEntity(
            NodeEntity(0, zid, number, name), number, "MP", topic.name, type_name(message),
            type_hash(message), qos,
        )  # fmt: skip
        token = keys.token_key(entity)
        self.gid = keys.gid(token)
        return self.session.liveliness().declare_token(token)


@pytest.fixture(scope="module")
def peer(robot: AttackedRobot) -> Iterator[Peer]:
    """The attacker."""
    with robot.attacker() as session:
        yield Peer(session)


def rejects(before: PortStatus, now: PortStatus) -> bool:
    """Whether an input has rejected an invalid message, or refused it unread if exclusive."""
    return now.invalid + now.refused > before.invalid + before.refused


def refuses(before: PortStatus, now: PortStatus) -> bool:
    """Whether an exclusive input has refused at least 5 messages."""
    return now.refused >= before.refused + 5


# --- Messages that are not valid ------------------------------------------------------------------


@pytest.mark.parametrize("damage", INVALID)
def test_invalid_message_is_rejected_by_every_reader(
    robot: AttackedRobot, peer: Peer, damage: str, cases: Cases
) -> None:
    cases(INVALID[damage])
    payloads = {topic: invalid(topic)[damage] for topic in INVALID[damage]}

    peer.put_until(
        robot,
        {topic: ((data, peer.attachment().encode()) for data in itertools.repeat(payload))
         for topic, payload in payloads.items()},
        rejects,
    )  # fmt: skip

    for topic in payloads:
        for component, _ in topic.readers:
            robot.await_log(component, f"(rejected invalid|refused) message on {topic.name} ")


# --- Exclusive topics -----------------------------------------------------------------------------


def _signed(topic: Topic, peer: Peer, key: bytes, sent_ns: int | None = None) -> bytes:
    """Return an attachment with a proof made with any key."""
    attachment = peer.attachment()
    proof = Signer(Exclusive("/robot/x", key), topic.key).proof(attachment.head(), AHEAD)
    if sent_ns is not None:
        proof = sent_ns.to_bytes(8, "little", signed=True) + proof[8:]
    return attachment._replace(proof=proof).encode()


FORGED: Final[dict[str, tuple[Callable[[Topic, Peer], bytes | None], str]]] = {
    "no_attachment": (lambda _, __: None, "it is not signed"),
    "empty_attachment": (lambda _, __: b"", "it is not signed"),
    "garbage": (lambda _, __: b"\xff" * 33, "it is not signed"),
    "long_attachment": (lambda _, __: bytes(2000), "it is not signed"),
    "unsigned": (lambda _, peer: peer.attachment().encode(), "it is not signed"),
    "zero_proof": (
        lambda _, peer: peer.attachment(proof=bytes(PROOF_BYTES)).encode(),
        "repeats or precedes",
    ),
    "own_key": (lambda topic, peer: _signed(topic, peer, secrets.token_bytes(32)), "signature"),
    "zero_key": (lambda topic, peer: _signed(topic, peer, bytes(32)), "signature"),
    "from_the_future": (lambda topic, peer: _signed(topic, peer, bytes(32), 2**63 - 1),
                        "signature"),
    "negative_time": (lambda topic, peer: _signed(topic, peer, bytes(32), -1),
                      "repeats or precedes"),
}  # fmt: skip


@pytest.mark.parametrize("forgery", FORGED)
@pytest.mark.parametrize("name", COMMANDS)
def test_forged_command_is_refused(
    robot: AttackedRobot, peer: Peer, name: str, forgery: str
) -> None:
    topic = topics()[name]
    make, reason = FORGED[forgery]

    with closing(_Token(peer.announce(f"/robot/forger_{forgery}", topic, topic.message))):
        messages = ((AHEAD, make(topic, peer)) for _ in itertools.count())
        peer.put_until(robot, {topic: messages}, refuses)

    for component, _ in topic.readers:
        robot.await_log(component, f"refused message on {topic.name} from .*{reason}")


@pytest.mark.parametrize("claimed", ["/robot/intruder", "/robot/velocity_gate", "/robot/base"])
@pytest.mark.parametrize("name", COMMANDS)
def test_second_writer_is_refused_and_named(
    robot: AttackedRobot, peer: Peer, name: str, claimed: str
) -> None:
    topic = topics()[name]
    with closing(_Token(peer.announce(claimed, topic, topic.message))):
        messages = ((AHEAD, peer.attachment().encode()) for _ in itertools.count())
        peer.put_until(robot, {topic: messages}, refuses)

    for component, _ in topic.readers:
        robot.await_log(component, f"refused message on {topic.name} from .*{claimed}")


class _Token:
    def __init__(self, token: Any) -> None:
        self.close = token.undeclare


@pytest.fixture(scope="module")
def recorded(robot: AttackedRobot, peer: Peer) -> dict[str, list[zenoh.Sample]]:
    """What an attacker that listens records of each exclusive topic during a drive."""
    found: dict[str, list[zenoh.Sample]] = {name: [] for name in COMMANDS}
    subscribers = [
        peer.session.declare_subscriber(
            topics()[name].key, zenoh.handlers.Callback(samples.append, indirect=False)
        )
        for name, samples in found.items()
    ]
    robot.reach_goal()
    for subscriber in subscribers:
        subscriber.undeclare()
    assert all(len(samples) > 20 for samples in found.values())
    return found


def _replays(
    name: str, samples: list[zenoh.Sample], peer: Peer
) -> Iterator[tuple[bytes, bytes | None]]:
    for sample in itertools.cycle(samples):
        assert sample.attachment is not None
        sent = Attachment.decode(sample.attachment.to_bytes())
        payload = sample.payload.to_bytes()
        match name:
            case "replayed":
                yield payload, sent.encode()
            case "other_command":
                yield AHEAD, sent.encode()
            case "newer_time":
                newest = (2**62).to_bytes(8, "little")
                yield payload, sent._replace(proof=newest + sent.proof[8:]).encode()
            case "own_identity":
                yield payload, sent._replace(gid=peer.gid).encode()
            case "next_sequence":
                yield payload, sent._replace(sequence=sent.sequence + 1_000_000).encode()


@pytest.mark.parametrize(
    "how", ["replayed", "other_command", "newer_time", "own_identity", "next_sequence"]
)
@pytest.mark.parametrize("name", COMMANDS)
def test_recorded_command_is_refused(
    robot: AttackedRobot,
    peer: Peer,
    recorded: dict[str, list[zenoh.Sample]],
    name: str,
    how: str,
) -> None:
    topic = topics()[name]

    peer.put_until(robot, {topic: _replays(how, recorded[name], peer)}, refuses)

    for component, _ in topic.readers:
        robot.await_log(component, f"refused message on {topic.name} from ")


def test_command_signed_for_one_topic_is_refused_on_another(
    robot: AttackedRobot, peer: Peer, recorded: dict[str, list[zenoh.Sample]]
) -> None:
    for name, other in itertools.permutations(COMMANDS, 2):
        replays = _replays("replayed", recorded[other], peer)
        peer.put_until(robot, {topics()[name]: replays}, refuses)


# --- Types, lengths and identities ----------------------------------------------------------------


def test_wrong_type_is_not_received_and_reported_with_its_publisher(
    robot: AttackedRobot, peer: Peer, cases: Cases
) -> None:
    cases(topics())
    with ExitStack() as stack, nothing_arrives(robot):
        for name, topic in topics().items():
            wrong = Topic(topic.name, String, (), exclusive=False, operated=False)
            stack.callback(peer.announce(f"/robot/liar_{name}", wrong, String).undeclare)
            for payload in (valid(topic.message), CODEC.encode(String(data="x"))):
                peer.put(wrong.key, payload, peer.attachment().encode())
        for name, topic in topics().items():
            robot.await_log(
                topic.readers[0][0], f"/robot/liar_{name}.*std_msgs/msg/String|further publishers"
            )


@pytest.mark.parametrize("wrong", ["RIHS01_", "TypeHashNotSupported", "RIHS01_" + "0" * 64])
def test_wrong_type_hash_is_not_received(
    robot: AttackedRobot, peer: Peer, wrong: str, cases: Cases
) -> None:
    cases(topics())
    with nothing_arrives(robot):
        for topic in topics().values():
            key = topic.key.rpartition("/")[0]
            peer.put(f"{key}/{wrong}", b"\xff" * 64, peer.attachment().encode())


@contextmanager
def nothing_arrives(robot: AttackedRobot) -> Iterator[None]:
    """Check that no input receives anything that it would reject."""
    robot.next_statuses()  # with what was sent before
    before = {topic: robot.ports(topic) for topic in topics().values()}
    yield
    robot.next_statuses()
    for topic, ports in before.items():
        for was, now in zip(ports, robot.ports(topic), strict=True):
            assert (now.invalid, now.refused) == (was.invalid, was.refused), topic


@pytest.mark.parametrize(("megabytes", "names"), [(2, tuple(topics())), (8, LARGE), (30, LARGE)])
def test_huge_message_is_discarded_or_rejected(
    robot: AttackedRobot, peer: Peer, megabytes: int, names: Sequence[str], cases: Cases
) -> None:
    cases(names)
    for name in names:
        payload = valid(topics()[name].message) + bytes(megabytes << 20)
        peer.put(topics()[name].key, payload, peer.attachment().encode())
    robot.next_statuses()

    assert robot.harm().peak_mb < MOST_MEMORY_MB


def test_message_longer_than_any_other_closes_at_most_the_link_of_its_sender(
    robot: AttackedRobot,
) -> None:
    with robot.attacker() as session:
        session.put(topics()["scan"].key, bytes(70 << 20), congestion_control=BLOCK)
        robot.next_statuses()

    assert robot.harm().peak_mb < MOST_MEMORY_MB


def test_forged_status_has_no_effect(robot: AttackedRobot, peer: Peer, cases: Cases) -> None:
    cases(components())
    key = keys.message_key(0, "/robot/component_status", ComponentStatus)
    for component in components():
        hung = ComponentStatus(
            header=Header(), component=component, state="active", handler="a", handler_s=1e6,
            pid=robot.pids.get(component, robot.run.process.pid),
        )  # fmt: skip
        ended = ComponentStatus(header=Header(), component=component, state="finalized")
        for status in (hung, ended):
            peer.put(key, CODEC.encode(status), peer.attachment().encode())
    robot.next_statuses()

    assert robot.harm().replaced == []


def test_false_queryables_do_not_change_components(
    robot: AttackedRobot, peer: Peer, cases: Cases
) -> None:
    cases(components())
    false: list[Any] = [
        peer.session.declare_queryable(
            keys.control_key(0, f"/robot/{component}"),
            lambda query: query.reply(query.key_expr, b'{"value": "finalized"}'),
        )
        for component in components()
    ]
    robot.next_statuses()
    for queryable in false:
        queryable.undeclare()

    assert robot.harm().replaced == []


# --- False sessions, floods -----------------------------------------------------------------------


def _restart(robot: AttackedRobot, component: str) -> float:
    """Restart a component by its own user; return how long that takes [s]."""
    begin = time.monotonic()
    try:
        robot.client.connection.request(
            "/robot/vision_supervisor", "restart", {"name": component}, timeout_s=30.0
        )
    finally:
        took = time.monotonic() - begin
        robot.pids[component] = robot.run.pid_of(component)
    return took


def _ps(robot: AttackedRobot) -> tuple[float, list[dict[str, Any]]]:
    begin = time.monotonic()
    answer = cairn("ps", "--json", connect=robot.run.endpoint)
    assert answer.code == 0, answer
    return time.monotonic() - begin, answer.json


def test_forged_session_ids_are_not_waited_for(robot: AttackedRobot, peer: Peer) -> None:
    before = _restart(robot, RESTARTED)
    queryables = [
        peer.session.declare_queryable(
            keys.session_key(session_id("wrong")), zenoh.handlers.RingChannel(1)
        )
        for _ in range(100)
    ]
    took = _restart(robot, RESTARTED)
    for queryable in queryables:
        queryable.undeclare()

    assert took <= 2.0 * before + 1.0


@pytest.mark.parametrize("name", ["scan", "odom", "cmd_vel", "map", "goal_pose"])
def test_flood_is_bounded_and_the_robot_stays_unharmed(
    robot: AttackedRobot, peer: Peer, name: str
) -> None:
    topic = topics()[name]
    payload = invalid(topic)["truncated"]

    for _ in range(20_000):
        peer.put(topic.key, payload, peer.attachment().encode())
    robot.next_statuses()

    assert robot.harm().replaced == []


# --- Afterward ------------------------------------------------------------------------------------


def test_refusals_are_visible_in_ps(robot: AttackedRobot) -> None:
    rows = {row["component"]: row for row in _ps(robot)[1]}

    assert rows["/robot/base"]["refused"] > 0
    assert rows["/robot/velocity_gate"]["refused"] > 0
    readers = {component for topic in topics().values() if not topic.exclusive
               for component, _ in topic.readers}  # fmt: skip
    for component in readers - {RESTARTED}:
        assert rows[f"/robot/{component}"]["invalid"] > 0, component


def test_afterward_the_robot_is_unharmed(
    robot: AttackedRobot, unharmed: Callable[[AttackedRobot], None]
) -> None:
    unharmed(robot)
