"""The live source, with components on a bus of their own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from cairn import LATCHED, RELIABLE, SENSOR
from cairn.bus.codec import Codec
from cairn.bus.keys import EndpointEntity, NodeEntity, token_key
from cairn.bus.session import open_client
from cairn.bus.type_hash import definition, type_hash
from cairn.bus.zenoh_bus import ZenohBus
from cairn.client.connection import Connection
from cairn.console import live as live_module
from cairn.console.live import LiveSource
from cairn.console.message_types import MessageType, MessageTypes
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.message import type_name
from cairn.schemas.std_msgs import String
from tests.cairn.bus.network import Network, Reader, eventually, router_at
from tests.cairn.console.conftest import NoLease, Running, running

pytestmark = pytest.mark.processes


@pytest.fixture
def network() -> Iterator[Network]:
    network = Network()
    try:
        yield network
    finally:
        network.close()


@pytest.fixture
def live(network: Network) -> Iterator[Running]:
    with running(LiveSource(network.endpoint), operations=NoLease) as console:
        yield console


def channel_of(live: Running, topic: str) -> int:
    """Wait for the channel of a topic, and return its id."""
    ids: dict[str, int] = {}

    def exists() -> bool:
        ids.update({one.topic: one.id for one in list(live.hub.channels.values())})
        return topic in ids

    assert eventually(exists)
    return ids[topic]


def test_topics_appear_and_vanish_with_their_publishers(network: Network, live: Running) -> None:
    page = live.browser()
    assert page.text("advertise")["channels"] == []
    node = network.bus().node("/robot/base", print)

    publisher = node.advertise("/robot/cmd", Twist, SENSOR)
    (channel,) = page.text("advertise")["channels"]
    publisher.close()

    assert channel["schemaName"] == "geometry_msgs/msg/Twist"
    assert channel["schema"] == definition(Twist)
    assert page.text("unadvertise")["channelIds"] == [channel["id"]]
    page.close()


def test_latched_message_and_then_further_ones_arrive_as_on_the_wire(
    network: Network, live: Running
) -> None:
    node = network.bus().node("/robot/talker", print)
    publisher = node.advertise("/robot/word", String, LATCHED)
    publisher.publish(String(data="kept"))
    channel = channel_of(live, "/robot/word")
    page, second = live.browser(), live.browser()

    page.send(op="subscribe", subscriptions=[{"id": 1, "channelId": channel}])
    assert page.data()[2] == Codec().encode(String(data="kept"))
    second.send(op="subscribe", subscriptions=[{"id": 2, "channelId": channel}])
    assert second.data()[2] == Codec().encode(String(data="kept"))
    publisher.publish(String(data="new"))

    assert page.data()[2] == second.data()[2] == Codec().encode(String(data="new"))
    page.close()
    second.close()


def test_subscribing_and_unsubscribing_endlessly_burdens_no_robot(
    network: Network, live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = network.bus().node("/robot/talker", print).advertise("/robot/word", String, LATCHED)
    publisher.publish(String(data="kept"))
    channel = channel_of(live, "/robot/word")
    opened: list[str] = []
    subscriber = Connection.subscriber

    def counted(connection: Connection, key: str, handler: object, *, latched: bool) -> object:
        opened.append(key)
        return subscriber(connection, key, handler, latched=latched)

    monkeypatch.setattr(Connection, "subscriber", counted)
    page = live.browser()

    for number in range(20):
        page.send(op="subscribe", subscriptions=[{"id": number, "channelId": channel}])
        assert page.data()[0] == number
        page.send(op="unsubscribe", subscriptionIds=[number])

    assert len(opened) == 1
    page.close()


def test_subscriptions_of_a_busy_topic_come_and_go(
    network: Network, live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_module, "_LINGER_S", 0.0)
    publisher = network.bus().node("/robot/talker", print).advertise("/robot/word", String, SENSOR)
    channel = channel_of(live, "/robot/word")
    page = live.browser()

    for number in range(30):
        page.send(op="subscribe", subscriptions=[{"id": number, "channelId": channel}])
        assert eventually(lambda: publisher.has_subscribers)
        for _ in range(20):
            publisher.publish(String(data="busy"))
        while page.data()[0] != number:
            pass
        page.send(op="unsubscribe", subscriptionIds=[number])
        assert eventually(lambda: not publisher.has_subscribers)
    page.close()


def test_foreign_nodes_are_known(network: Network, live: Running) -> None:
    network.bus().node("/robot/base", print).advertise("/robot/odom", Twist, RELIABLE)
    node = NodeEntity(0, "5e55", 0, "/ros/rviz")
    rviz = EndpointEntity(
        node, 1, "MS", "/robot/odom", type_name(Twist), type_hash(Twist), RELIABLE
    )
    with open_client([network.endpoint]) as session:
        token = session.liveliness().declare_token(token_key(rviz))

        assert eventually(lambda: live.hub.graph.foreign == {"/ros/rviz"})
        assert live.hub.graph.subscribers["/robot/odom"] == {"/ros/rviz"}
        token.undeclare()


def test_publication_of_a_browser_reaches_a_component(network: Network, live: Running) -> None:
    node = network.bus().node("/robot/base", print)
    reader = Reader(node, "/robot/cmd", Twist, RELIABLE)
    page = live.browser("foxglove.websocket.v1")
    assert eventually(lambda: "/robot/cmd" in live.hub.graph.subscribers)
    for id_, type_ in ((1, "geometry_msgs/msg/Twist"), (2, "std_msgs/msg/String")):
        page.send(op="advertise", channels=[
            {"id": id_, "topic": "/robot/cmd", "encoding": "cdr", "schemaName": type_}
        ])  # fmt: skip
    twist = Twist(linear=Vector3(x=0.5))

    page.socket.send(b"\x01\x01\0\0\0" + Codec().encode(twist))
    page.socket.send(b"\x01\x02\0\0\0" + Codec().encode(String(data="no")))

    assert reader.next() == twist
    assert "no component subscribes" in page.text("status", level=2)["message"]
    page.close()


def test_type_of_a_plugin_gets_its_schema_once_it_is_known(
    network: Network, live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = MessageType("lamp_msgs/msg/Lamp", "RIHS01_lamp", "bool lit", False, 1000)

    async def load(types: MessageTypes) -> None:
        types._known[known.name] = known

    monkeypatch.setattr(MessageTypes, "load_plugins", load)
    page = live.browser()
    session = network.bus().session
    node = NodeEntity(0, str(session.info.zid()), 0, "/robot/lamp")
    lamp = EndpointEntity(node, 1, "MP", "/robot/lamp", known.name, known.type_hash, SENSOR)
    token = session.liveliness().declare_token(token_key(lamp))

    found = page.text("advertise")["channels"]
    while not (found and found[0]["schema"]):
        found = page.text("advertise")["channels"]

    assert (found[0]["topic"], found[0]["schema"]) == ("/robot/lamp", "bool lit")
    token.undeclare()
    page.close()


def test_console_says_that_the_robot_has_ended_and_connects_again(network: Network) -> None:
    with running(LiveSource(network.endpoint)) as live:
        node = network.bus().node("/robot/base", print)
        node.advertise("/robot/cmd", Twist, SENSOR)
        channel_of(live, "/robot/cmd")
        page = live.browser()
        assert page.event("link")["connected"]

        network.close()

        lost = page.event("link")
        assert not lost["connected"]
        assert "connects again" in lost["reason"]
        assert page.text("unadvertise")["channelIds"]
        restarted = ZenohBus(router_at(network.endpoint))
        while not page.event("link")["connected"]:
            pass
        restarted.close()
        page.close()
