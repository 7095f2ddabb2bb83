"""A bus declares and sends in rmw_zenoh's format, as seen by a bare Zenoh session."""

import queue
import signal
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
import zenoh

from cairn import LATCHED, SENSOR, CairnError, Qos
from cairn.bus.codec import Codec
from cairn.bus.graph import GraphReader, read_graph
from cairn.bus.keys import (
    Attachment,
    EndpointEntity,
    NodeEntity,
    endpoints_pattern,
    gid,
    token_key,
    tokens_pattern,
)
from cairn.bus.session import open_client, open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.sensor_msgs import Image
from cairn.schemas.std_msgs import String
from tests.cairn.bus.network import Network, Reader, eventually, node, router_process, stop
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


TWIST = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def test_node_declares_the_liveliness_tokens_of_rmw_zenoh(network: Network) -> None:
    bus = network.bus()
    zid = bus.session.info.zid()
    localizer = node(bus, "/robot/localizer")
    localizer.advertise("/robot/cmd_vel", Twist, SENSOR)
    localizer.subscribe("/robot/word", String, LATCHED, lambda: None)
    lonely = node(bus, "/lonely")
    lonely.advertise("/word", String, Qos("reliable", "volatile", 42))
    bus.wait_for_peers(LIMIT_S)
    with open_client([network.endpoint]) as command:
        replies = command.liveliness().get("@ros2_lv/**", timeout=LIMIT_S)
        tokens = sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    place = "%/%robot/localizer"
    assert tokens == [
        f"@ros2_lv/0/{zid}/0/0/NN/{place}",
        f"@ros2_lv/0/{zid}/0/1/MP/{place}/%robot%cmd_vel/geometry_msgs::msg::dds_::Twist_/{TWIST}/"
        "2::,5:,:,:,,",
        f"@ros2_lv/0/{zid}/0/2/MS/{place}/%robot%word/std_msgs::msg::dds_::String_/{STRING}/"
        ":1:,1:,:,:,,",
        f"@ros2_lv/0/{zid}/3/3/NN/%/%/lonely",
        f"@ros2_lv/0/{zid}/3/4/MP/%/%/lonely/%word/std_msgs::msg::dds_::String_/{STRING}/"
        "::,:,:,:,,",
    ]


def test_published_sample_has_the_key_payload_and_attachment_of_rmw_zenoh(network: Network) -> None:
    bus = network.bus()
    base = node(bus, "/robot/base")
    writer = base.advertise("/robot/cmd_vel", Twist, SENSOR)
    plain = network.bus()
    ring: zenoh.handlers.RingChannel[Any] = zenoh.handlers.RingChannel(10)
    everything: Any = plain.session.declare_subscriber("0/robot/**", ring)
    plain.wait_for_peers(LIMIT_S)
    bus.wait_for_peers(LIMIT_S)  # the router knows its tokens, too
    before = time.time_ns()

    for speed in (0.25, 0.5):
        writer.publish(Twist(linear=Vector3(x=speed)))

    samples = [everything.recv() for _ in range(2)]
    (endpoint,) = (one for one in network.graph() if isinstance(one, EndpointEntity))
    for number, (speed, sample) in enumerate(zip((0.25, 0.5), samples, strict=True), start=1):
        assert str(sample.key_expr) == f"0/robot/cmd_vel/geometry_msgs::msg::dds_::Twist_/{TWIST}"
        assert str(sample.encoding) == "application/cdr;geometry_msgs/msg/Twist"
        payload = sample.payload.to_bytes()
        assert payload[:4] == b"\0\1\0\0"
        assert payload == Codec().encode(Twist(linear=Vector3(x=speed)))
        raw = sample.attachment.to_bytes()
        assert len(raw) == 33
        attachment = Attachment.decode(raw)
        assert attachment.sequence == number
        assert before <= attachment.sent_ns <= time.time_ns()
        assert attachment.gid == gid(token_key(endpoint))
        assert sample.congestion_control == zenoh.CongestionControl.DROP


def test_bulk_messages_have_lower_priority(network: Network) -> None:
    bus, plain = network.bus(), network.bus()
    robot = node(bus, "/robot/base")
    ring: zenoh.handlers.RingChannel[Any] = zenoh.handlers.RingChannel(10)
    everything: Any = plain.session.declare_subscriber("0/robot/**", ring)
    plain.wait_for_peers(LIMIT_S)

    for topic, message, priority in (
        ("/robot/cmd_vel", Twist(), zenoh.Priority.INTERACTIVE_HIGH),
        ("/robot/camera", Image(), zenoh.Priority.DATA_LOW),
    ):
        robot.advertise(topic, type(message), SENSOR).publish(message)
        assert everything.recv().priority == priority


def test_graph_lists_nodes_alive_and_omits_closed_ones(network: Network) -> None:
    bus = network.bus()
    one, other = node(bus, "/robot/one"), node(bus, "/other")
    one.advertise("/robot/word", String, SENSOR)
    bus.wait_for_peers(LIMIT_S)
    graph = network.graph()
    assert [one.name for one in graph if isinstance(one, NodeEntity)] == ["/robot/one", "/other"]
    assert [one.topic for one in graph if isinstance(one, EndpointEntity)] == ["/robot/word"]

    one.close()

    assert eventually(lambda: _names(network) == ["/other"])
    other.close()
    assert eventually(lambda: _names(network) == [])


def _names(network: Network) -> list[str]:
    return [one.name for one in network.graph() if isinstance(one, NodeEntity)]


def test_client_is_shown_endpoints_that_appear_and_end(network: Network) -> None:
    first = node(network.bus(), "/robot/first")
    first.advertise("/robot/word", String, SENSOR)
    assert eventually(lambda: len(network.graph()) == 2)
    reported: queue.Queue[list[str]] = queue.Queue()

    def report(found: Mapping[str, EndpointEntity]) -> None:
        reported.put(sorted(one.topic for one in found.values()))

    with open_client([network.endpoint]) as client:
        reader = GraphReader(client, endpoints_pattern(0, kind="MP"), report)
        assert reported.get(timeout=LIMIT_S) == ["/robot/word"]
        second = node(network.bus(), "/robot/second")
        second.advertise("/robot/twist", Twist, SENSOR)
        reader.read_soon()
        assert reported.get(timeout=LIMIT_S) == ["/robot/twist", "/robot/word"]
        second.close()
        assert reported.get(timeout=LIMIT_S) == ["/robot/word"]

        reader.close()
        first.close()
        assert eventually(lambda: network.graph() == [])
        assert reported.empty()


def test_router_that_does_not_list_the_graph_in_time_is_an_error() -> None:
    with router_process() as (endpoint, router), open_client([endpoint]) as command:
        assert read_graph(command, tokens_pattern(0), LIMIT_S) == []
        stop(router)

        with pytest.raises(CairnError, match="the router did not list the components within"):
            read_graph(command, tokens_pattern(0), 0.2)


def test_images_of_a_stereo_pair_wait_for_a_process_that_is_held_up() -> None:
    pair = ("/robot/left_image", "/robot/right_image")
    image = Image(
        height=480, width=640, encoding="mono8", step=640, data=np.zeros(307200, np.uint8)
    )
    with (
        router_process() as (endpoint, router),
        open_client([endpoint]) as sender,
        open_client([endpoint]) as receiver,
    ):
        ear, eyes = node(ZenohBus(receiver), "/robot/ear"), node(ZenohBus(sender), "/robot/eyes")
        readers = [Reader(ear, topic, Image, SENSOR) for topic in pair]
        writers = [eyes.advertise(topic, Image, SENSOR) for topic in pair]
        assert eventually(lambda: all(writer.has_subscribers for writer in writers))
        stop(router)
        for writer in writers:
            writer.publish(image)
        router.send_signal(signal.SIGCONT)

        assert [len(reader.next().data) for reader in readers] == [307200, 307200]


def test_domains_are_isolated(network: Network) -> None:
    bus = network.bus()
    reader = Reader(node(bus, "/robot/ear"), "/robot/word", String, SENSOR)
    elsewhere = ZenohBus(open_peer([network.endpoint]), domain=7)
    try:
        mouth = node(elsewhere, "/robot/mouth")
        writer = mouth.advertise("/robot/word", String, SENSOR)
        here = node(network.bus(), "/robot/here").advertise("/robot/word", String, SENSOR)
        elsewhere.wait_for_peers(LIMIT_S)
        bus.wait_for_peers(LIMIT_S)
        writer.publish(String(data="elsewhere"))
        here.publish(String(data="here"))
        assert reader.next() == String(data="here")
        assert [type(one) for one in network.graph(domain=7)] == [NodeEntity, EndpointEntity]
    finally:
        elsewhere.close()


@pytest.mark.parametrize("watched_first", [True, False])
def test_each_endpoint_is_reported_once_in_any_race(network: Network, watched_first: bool) -> None:
    bus, other = network.bus(), network.bus()
    reported: list[EndpointEntity] = []
    ends: list[Callable[[], None]] = []
    if watched_first:
        ends.append(bus.graph.watch("/robot/word", reported.append))
    names = [f"/robot/part{number}" for number in range(50)]
    for number, name in enumerate(names):
        node(other, name).advertise("/robot/word", String, SENSOR)
        if number == 25 and not watched_first:
            ends.append(bus.graph.watch("/robot/word", reported.append))

    assert eventually(lambda: len(reported) >= len(names))
    assert sorted(one.node.name for one in reported) == sorted(names)

    for end in ends:
        end()
        end()
    last = Reader(node(bus, "/robot/ear"), "/robot/word", String, SENSOR)
    more = node(other, "/robot/more").advertise("/robot/word", String, SENSOR)
    other.wait_for_peers(LIMIT_S)
    more.publish(String(data="more"))
    last.next()
    assert len(reported) == len(names)
