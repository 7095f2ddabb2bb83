"""Invalid data from foreign or broken peers is rejected and counted, without other effects."""

from __future__ import annotations

import struct
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zenoh

from cairn import RELIABLE
from cairn.bus.codec import Codec
from cairn.bus.graph import GraphWatcher
from cairn.bus.keys import (
    Attachment,
    EndpointEntity,
    NodeEntity,
    data_key,
    gid,
    token_key,
)
from cairn.bus.type_hash import type_hash
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.sensor_msgs import LaserScan
from tests.cairn.bus.network import Network, Reader, eventually, node
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


CODEC = Codec()
GOOD = CODEC.encode(Twist(linear=Vector3(x=0.5)))
HEADER = GOOD[:4]
KEY = data_key(0, "/robot/cmd_vel", type_name(Twist), type_hash(Twist))


@pytest.fixture
def reader(network: Network) -> Reader:
    bus = network.bus()
    return Reader(node(bus, "/robot/base"), "/robot/cmd_vel", Twist, RELIABLE)


@pytest.fixture
def foreign(network: Network, reader: Reader) -> ZenohBus:
    bus = network.bus()
    bus.wait_for_peers(LIMIT_S)
    return bus


def attachment(number: int, publisher: bytes = bytes(16)) -> bytes:
    return Attachment(number, time.time_ns(), publisher).encode()


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (HEADER + struct.pack("<6d", 0, float("nan"), 0, 0, 0, 0), "linear.y = nan: must be"),
        (HEADER + struct.pack("<6d", 0, 0, 0, 0, 0, float("inf")), "angular.z = inf: must be"),
        (GOOD[:-1], "51 bytes are not CDR of this type"),
        (HEADER, "4 bytes are not CDR of this type"),
        (b"", "0 bytes are not CDR of this type"),
        (b"\xff" * 52, "52 bytes are not CDR of this type"),
        (b'{"linear": {"x": 1.0}}', "22 bytes are not CDR of this type"),
    ],
    ids=["nan", "infinity", "truncated", "header only", "empty", "garbage", "json"],
)
def test_invalid_message_is_rejected_and_the_next_one_received(
    reader: Reader, foreign: ZenohBus, payload: bytes, message: str
) -> None:
    foreign.session.put(KEY, payload, attachment=attachment(1))
    foreign.session.put(KEY, GOOD, attachment=attachment(2))

    with pytest.raises(InvalidMessage, match="geometry_msgs/msg/Twist: ") as rejected:
        reader.next()
    assert message in str(rejected.value)
    assert reader.next() == Twist(linear=Vector3(x=0.5))
    subscription = reader.subscription
    assert (subscription.invalid, subscription.received, subscription.dropped) == (1, 1, 0)


def test_repairs_are_reported_once_for_each_publisher(network: Network) -> None:
    bus, warnings = network.bus(), list[str]()
    subscriber = bus.node("/robot/localizer", warnings.append, warnings.append)
    reader = Reader(subscriber, "/scan", LaserScan, RELIABLE)
    other = network.bus()
    other.wait_for_peers(LIMIT_S)
    scan = LaserScan(range_max=9.0, ranges=np.ones(1, np.float32))
    scan.__dict__["angle_max"] = 1.0
    key = data_key(0, "/scan", type_name(LaserScan), type_hash(LaserScan))
    for number in (1, 2, 3):
        other.session.put(key, CODEC.encode(scan), attachment=attachment(number))

    assert [reader.next().angle_max for _ in range(3)] == [0.0] * 3

    (warning,) = [one for one in warnings if "repaired" in one]
    assert "/scan from a publisher that is not in the graph" in warning
    assert "angle_max is not that of the last beam" in warning


@pytest.mark.parametrize(
    "odd",
    [None, b"", b"?", bytes(33), b"\xff" * 33, b"x" * 5000],
    ids=["none", "empty", "short", "no gid", "garbage", "long"],
)
def test_message_without_sequence_numbers_is_received(
    reader: Reader, foreign: ZenohBus, odd: bytes | None
) -> None:
    for _ in range(2):
        foreign.session.put(KEY, GOOD, attachment=odd)
        assert reader.next() == Twist(linear=Vector3(x=0.5))

    assert reader.subscription.dropped == 0


@pytest.mark.parametrize(
    ("numbers", "dropped"),
    [
        ([7, 8, 9], 0),
        ([7, 9, 12], 3),
        ([7, 8, 1, 2], 0),
        ([2**63 - 1, -(2**63), 5], 0),
    ],
    ids=["from any number", "with gaps", "restarted", "beyond all bounds"],
)
def test_only_gaps_in_a_publishers_numbers_count_as_dropped(
    reader: Reader, foreign: ZenohBus, numbers: list[int], dropped: int
) -> None:
    for number in numbers:
        foreign.session.put(KEY, GOOD, attachment=attachment(number))
        reader.next()

    assert eventually(lambda: reader.subscription.dropped == dropped)


def test_peer_that_invents_publishers_does_not_fill_the_memory(
    reader: Reader, foreign: ZenohBus
) -> None:
    def put(payload: bytes, gid: bytes) -> None:
        # By default Zenoh drops messages if the link stalls.
        block = zenoh.CongestionControl.BLOCK
        foreign.session.put(KEY, payload, attachment=attachment(1, gid), congestion_control=block)

    for number in range(3000):
        put(GOOD, number.to_bytes(16, "little"))
    put(CODEC.encode(Twist()), b"\xff" * 16)

    def received_the_last() -> bool:
        return Twist() in reader.pending()

    assert eventually(received_the_last)
    subscription = reader.subscription
    assert subscription.received + subscription.dropped <= 3001
    assert subscription.invalid == 0


def test_malformed_liveliness_token_is_ignored(network: Network) -> None:
    reported: list[str] = []
    own, foreign = network.bus(), network.bus()
    own.node("/robot/base", reported.append).advertise("/robot/cmd_vel", Twist, RELIABLE)
    tokens = [
        foreign.session.liveliness().declare_token(f"@ros2_lv/0/{rest}")
        for rest in ("x", "aa/0/0/NN/%/%/listener/more", "aa/0/1/MP/%/%/n/%t/type/hash/qos")
    ]
    other: list[str] = []
    foreign.node("/robot/other", other.append).subscribe(
        "/robot/cmd_vel", Vector3, RELIABLE, lambda: None
    )

    assert eventually(lambda: len(reported) == 1 and len(other) == 1)
    for token in tokens:
        token.undeclare()


def test_forged_tokens_with_another_type_do_not_fill_the_log(network: Network) -> None:
    reported: list[str] = []
    own, foreign = network.bus(), network.bus()
    own.node("/robot/base", reported.append).advertise("/robot/cmd_vel", Twist, RELIABLE)
    zid = str(foreign.session.info.zid())
    ghosts = [
        EndpointEntity(
            NodeEntity(0, zid, number, f"/robot/ghost_{number}"), 1, "MS", "/robot/cmd_vel",
            type_name(Vector3), type_hash(Vector3), RELIABLE,
        )
        for number in range(500)
    ]  # fmt: skip
    tokens = [foreign.session.liveliness().declare_token(token_key(ghost)) for ghost in ghosts]

    assert eventually(lambda: all(own.graph.endpoint(gid(token_key(one))) for one in ghosts))
    assert eventually(lambda: any("suppressed" in report for report in reported))
    assert len(reported) < 30
    for token in tokens:
        token.undeclare()


def ghosts_of(foreign: ZenohBus, topic: str, count: int) -> list[str]:
    """Return the tokens of publishers that do not exist."""
    zid = str(foreign.session.info.zid())
    return [
        token_key(EndpointEntity(
            NodeEntity(0, zid, number, f"/robot/ghost_{number}"), number, "MP", topic,
            type_name(Twist), type_hash(Twist), RELIABLE,
        ))
        for number in range(count)
    ]  # fmt: skip


def test_process_receives_only_the_tokens_of_its_own_topics(network: Network) -> None:
    own, foreign = network.bus(), network.bus()
    base = node(own, "/robot/base")
    base.advertise("/robot/cmd_vel", Twist, RELIABLE)
    base.advertise("/rosout", Twist, RELIABLE, shared=True)
    others = [*ghosts_of(foreign, "/robot/odom", 5), *ghosts_of(foreign, "/rosout", 5)]
    ghosts = [*others, *ghosts_of(foreign, "/robot/cmd_vel", 5)]
    tokens = [foreign.session.liveliness().declare_token(ghost) for ghost in ghosts]

    # They arrive in the order in which they were declared.
    assert eventually(lambda: own.graph.endpoint(gid(ghosts[-1])) is not None)
    assert [ghost for ghost in others if own.graph.endpoint(gid(ghost))] == []
    for token in tokens:
        token.undeclare()


def test_graph_is_complete_after_more_changes_than_could_be_kept(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.bus.graph._CONFIRMED_S", 1.0)
    own, foreign = network.bus(), network.bus()
    reported: list[str] = []
    stop = own.graph.watch("/robot/cmd_vel", lambda endpoint: reported.append(endpoint.node.name))
    ghosts = ghosts_of(foreign, "/robot/cmd_vel", 300)
    declare = foreign.session.liveliness().declare_token
    tokens = [declare(ghost) for ghost in ghosts[:20]]
    assert eventually(lambda: len(reported) == 20)

    monkeypatch.setattr("cairn.bus.graph._POLL_S", 2.0)  # in which more change than are kept
    assert eventually(lambda: own.graph.endpoint(gid(ghosts[19])) is not None)
    for token in tokens[:10]:
        token.undeclare()
    tokens = [*tokens[10:], *(declare(ghost) for ghost in ghosts[20:])]

    assert eventually(lambda: len(reported) >= 300)
    assert sorted(reported) == sorted(f"/robot/ghost_{number}" for number in range(300))
    assert eventually(lambda: not any(own.graph.endpoint(gid(one)) for one in ghosts[:10]))
    assert all(own.graph.endpoint(gid(one)) for one in ghosts[10:])
    stop()
    for token in tokens:
        token.undeclare()


class LivelinessOfLists:
    """A session whose liveliness subscriptions deliver one list of changes after the other."""

    def __init__(self, *lists: list[tuple[zenoh.SampleKind, str]]) -> None:
        self._lists = iter(lists)

    def liveliness(self) -> LivelinessOfLists:
        return self

    def declare_subscriber(self, _key: str, _ring: object, **_: object) -> SimpleNamespace:
        samples = [SimpleNamespace(kind=kind, key_expr=key) for kind, key in next(self._lists, [])]
        handler = SimpleNamespace(try_recv=lambda: samples.pop(0) if samples else None)
        return SimpleNamespace(handler=handler, undeclare=lambda: None)


def test_token_that_arrives_after_its_end_does_not_stay(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Zenoh sends what existed at a subscription beside what changes since."""
    monkeypatch.setattr("cairn.bus.graph._CONFIRMED_S", 2.0)
    put, delete = zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE
    gone, *others = ghosts_of(network.bus(), "/robot/cmd_vel", 70)
    session: Any = LivelinessOfLists(
        [(put, token) for token in (gone, *others)],
        [(delete, gone), (put, gone), *((put, token) for token in others)],
        [(put, token) for token in others],
    )
    graph = GraphWatcher(session, 0)
    graph.watch("/robot/cmd_vel", lambda _: None)
    graph.start()

    assert eventually(lambda: graph.endpoint(gid(gone)) is not None)
    assert eventually(lambda: graph.endpoint(gid(gone)) is None)
    assert all(graph.endpoint(gid(token)) for token in others)
    graph.close()


def test_topic_that_others_crowd_is_not_followed_further(
    network: Network, caplog: pytest.LogCaptureFixture
) -> None:
    own, foreign = network.bus(), network.bus()
    reader = Reader(node(own, "/robot/base"), "/robot/cmd_vel", Twist, RELIABLE)
    ghosts = ghosts_of(foreign, "/robot/cmd_vel", 1100)
    tokens = [foreign.session.liveliness().declare_token(ghost) for ghost in ghosts]

    assert eventually(lambda: "stopped following the endpoints of /robot/cmd_vel" in caplog.text)
    writer = node(foreign, "/robot/other").advertise("/robot/cmd_vel", Twist, RELIABLE)
    foreign.wait_for_peers(LIMIT_S)
    writer.publish(Twist())
    assert reader.next() == Twist()
    [late] = [end for end in network.graph() if isinstance(end, EndpointEntity) and end.kind == "MP"
              and end.node.name == "/robot/other"]  # fmt: skip
    assert own.graph.endpoint(gid(token_key(late))) is None
    for token in tokens:
        token.undeclare()
