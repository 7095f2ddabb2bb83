"""The hub and its protocol, with a source that the test moves."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import simplejpeg
from websockets.exceptions import ConnectionClosed

from cairn.bus.codec import Codec
from cairn.console import browser as browser_module
from cairn.console import hub as hub_module
from cairn.console.browser import Browser, BrowserSubscription
from cairn.console.source import Channel, ConnectionGraph, Message
from cairn.schemas.sensor_msgs import Image
from tests.cairn.bus.network import eventually
from tests.cairn.console.conftest import FakeSource, Running, running

SCAN = Channel(1, "/robot/scan", "sensor_msgs/msg/LaserScan", "float32[] ranges")
MAP = Channel(2, "/robot/map", "nav_msgs/msg/OccupancyGrid", "int8[] data", latched=True)
IMAGE = Channel(3, "/robot/left/image", "sensor_msgs/msg/Image", "uint8[] data")
STATUS = Channel(4, "/robot/component_status", "cairn_msgs/msg/ComponentStatus", "", latched=True)


def test_new_browser_receives_server_info_hello_and_channels(console: Running) -> None:
    console.call(console.hub.set_channels, [SCAN, STATUS])

    page = console.browser()

    assert page.text("serverInfo")["supportedEncodings"] == ["cdr", "json"]
    channels = page.text("advertise")["channels"]
    assert channels[0] == {
        "id": 1, "topic": "/robot/scan", "encoding": "cdr", "schemaEncoding": "ros2msg",
        "schemaName": "sensor_msgs/msg/LaserScan", "schema": "float32[] ranges",
    }  # fmt: skip
    hello = page.event("hello")
    assert (hello["mode"], hello["robots"], hello["may"]) == ("live", ["robot"], "steer")
    page.close()


def test_messages_reach_subscribers_only_and_the_topic_is_read_only_meanwhile(
    console: Running, source: FakeSource
) -> None:
    console.call(console.hub.set_channels, [SCAN, MAP])
    one, other = console.browser(), console.browser()

    one.send(op="subscribe", subscriptions=[{"id": 10, "channelId": 1}])
    other.send(op="subscribe", subscriptions=[{"id": 20, "channelId": 2}])
    assert eventually(lambda: sorted(source.subscribed) == ["/robot/map", "/robot/scan"])
    console.call(console.hub.deliver, 1, Message(123, b"scan"))
    console.call(console.hub.deliver, 2, Message(456, b"map"))

    assert one.data() == (10, 123, b"scan")
    assert other.data() == (20, 456, b"map")
    one.send(op="unsubscribe", subscriptionIds=[10])
    assert eventually(lambda: source.subscribed == ["/robot/map"])
    other.close()
    assert eventually(lambda: source.subscribed == [])
    one.close()


def test_second_subscriber_of_a_latched_topic_receives_what_is_kept(
    console: Running, source: FakeSource
) -> None:
    console.call(console.hub.set_channels, [MAP])
    source.last[2] = [Message(5, b"kept")]
    pages = [console.browser(), console.browser()]
    for page in pages:
        page.send(op="subscribe", subscriptions=[{"id": 1, "channelId": 2}])
        assert eventually(lambda: source.subscribed == ["/robot/map"])

    assert pages[1].data() == (1, 5, b"kept")
    for page in pages:
        page.close()


def test_vanished_topic_is_unadvertised_and_its_subscription_ends(
    console: Running, source: FakeSource
) -> None:
    console.call(console.hub.set_channels, [SCAN])
    page = console.browser()
    page.send(op="subscribe", subscriptions=[{"id": 1, "channelId": 1}])
    assert eventually(lambda: source.subscribed == ["/robot/scan"])

    console.call(console.hub.set_channels, [])

    assert page.text("unadvertise") == {"op": "unadvertise", "channelIds": [1]}
    assert source.subscribed == []
    page.close()


def test_images_are_sent_as_jpeg_on_request(console: Running, source: FakeSource) -> None:
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:, 32:] = (250, 10, 10)
    image = Image(height=48, width=64, encoding="rgb8", step=192, data=pixels.reshape(-1))
    cdr = Codec().encode(image)
    console.call(console.hub.set_channels, [IMAGE])
    page, foxglove = console.browser(), console.browser("foxglove.websocket.v1")
    page.send(op="subscribe", subscriptions=[{"id": 1, "channelId": 3, "jpeg": True}])
    foxglove.send(op="subscribe", subscriptions=[{"id": 1, "channelId": 3}])
    assert eventually(lambda: len(console.hub._subscribed[3]) == 2)

    console.call(console.hub.deliver, 3, Message(9, cdr))

    _, _, payload = page.data()
    assert struct.unpack_from("<II", payload) == (64, 48)
    decoded = simplejpeg.decode_jpeg(payload[8:])
    assert np.abs(decoded[24, 48].astype(int) - (250, 10, 10)).max() < 20
    assert foxglove.data() == (1, 9, cdr)
    page.close()
    foxglove.close()


def test_limit_of_the_rate_delivers_the_newest_message_last() -> None:
    subscription = BrowserSubscription(1, Channel(1, "/a", "b", "", depth=10), max_hz=10.0)
    sent = []
    for step in range(101):  # 100 Hz for 1 s
        now = 50.0 + step / 100
        subscription.put(Message(step, b""))
        if not subscription.wait_s(now):
            sent.append(subscription.take(now).time_ns)

    assert sent == list(range(0, 101, 10))
    subscription.put(Message(200, b""))
    assert subscription.take(52.0).time_ns == 200


def test_slow_browser_keeps_the_newest_scan_and_the_last_map_within_bounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(browser_module, "_DATA_BYTES", 1000)
    slow = Browser(1, "cairn.console.v1", "steer", _never)
    logs = Channel(5, "/rosout", "rcl_interfaces/msg/Log", "", depth=1000)
    subscriptions = [BrowserSubscription(id_, one) for id_, one in enumerate((SCAN, MAP, logs))]
    for one in subscriptions:
        slow.subscriptions[one.id] = one
    scans, maps, texts = subscriptions

    for number in range(50):
        slow.offer(maps, Message(number, bytes(800)))
        slow.offer(scans, Message(number, bytes(100)))
        slow.offer(texts, Message(number, bytes(40)))

    assert [len(scans), len(maps)] == [1, 1]
    assert sum(one.bytes for one in subscriptions) <= 1000
    assert scans.take(0).time_ns == maps.take(0).time_ns == 49
    assert len(slow._ready) <= 3


def test_browser_that_does_not_read_delays_no_other(console: Running) -> None:
    console.call(console.hub.set_channels, [SCAN])
    # What its library and the kernel receive for the idle one, at most 11 MB, is not waiting here.
    idle, page = console.browser(max_queue=1), console.browser()
    for one in (idle, page):
        one.send(op="subscribe", subscriptions=[{"id": 1, "channelId": 1}])
    assert eventually(lambda: sum(len(one.subscriptions) for one in console.hub.browsers) == 2)

    for number in range(40):
        console.call(console.hub.deliver, 1, Message(number, bytes(500_000)))
        assert page.data()[1] == number

    waiting = [one.bytes for two in console.hub.browsers for one in two.subscriptions.values()]
    assert sorted(waiting) == [0, 500_000]  # of the idle one, the newest
    idle.socket.close_socket()
    page.close()


def test_graph_is_sent_to_those_who_ask_and_then_what_changes(console: Running) -> None:
    nodes = frozenset({"/robot/base"})
    graph = ConnectionGraph({"/robot/odom": nodes}, {})
    console.call(console.hub.set_graph, graph)
    page = console.browser("foxglove.websocket.v1")

    page.send(op="subscribeConnectionGraph")
    first = page.text("connectionGraphUpdate")
    console.call(console.hub.set_graph, ConnectionGraph({}, {"/robot/scan": nodes}))
    change = page.text("connectionGraphUpdate")

    assert first["publishedTopics"] == [{"name": "/robot/odom", "publisherIds": ["/robot/base"]}]
    assert change["removedTopics"] == ["/robot/odom"]
    assert change["subscribedTopics"] == [{"name": "/robot/scan", "subscriberIds": ["/robot/base"]}]
    page.close()


def test_console_that_may_watch_neither_publishes_nor_changes(source: FakeSource) -> None:
    with running(source, "watch") as console:
        page = console.browser()

        refused = page.call("set_parameters", robot="robot", component="a", values={"x": 1})
        page.send(op="advertise", channels=[
            {"id": 1, "topic": "/robot/goal_pose", "encoding": "cdr", "schemaName": "a/msg/B"}
        ])  # fmt: skip

        assert "watch" in refused["error"]
        assert "watch" in page.text("status", level=2)["message"]
        page.close()


def test_browser_with_the_lease_publishes_what_it_has_advertised(
    console: Running, source: FakeSource
) -> None:
    console.call(console.hub.set_channels, [STATUS])
    page = console.browser("foxglove.websocket.v1")
    services = {one["name"]: one["id"] for one in page.text("advertiseServices")["services"]}
    page.send(op="advertise", channels=[
        {"id": 3, "topic": "/robot/goal_pose", "encoding": "cdr", "schemaName": "a/msg/B"}
    ])  # fmt: skip

    page.socket.send(b"\x01\x03\0\0\0CDR")
    assert "lease" in page.text("status")["message"]
    lease = struct.pack("<BIII", 2, services["/robot/acquire_lease"], 1, 4) + b"json{}"
    page.socket.send(lease)
    assert eventually(
        lambda: not console.hub.operations.refusal(next(iter(console.hub.browsers)), "robot")
    )
    page.socket.send(b"\x01\x03\0\0\0CDR")

    assert eventually(lambda: source.published == [("/robot/goal_pose", "a/msg/B", b"CDR")])
    page.socket.send(b"\x01\x04\0\0\0CDR")
    assert "channel 4" in page.text("status")["message"]
    page.close()


@pytest.mark.parametrize(
    ("call", "word"),
    [
        ({"method": "fly"}, "no method fly"),
        ({"method": "parameters", "arguments": {"robot": "robot"}}, "component"),
        ({"method": "parameters", "arguments": {"robot": "r", "component": "c", "x": 1}}, "x"),
        ({"method": "parameters", "arguments": {"robot": "r", "component": "c"}}, "no connection"),
    ],
)
def test_call_that_fails_is_answered_with_the_reason(
    idle_console: Running, call: dict[str, object], word: str
) -> None:
    page = idle_console.browser()

    page.send(op="call", id=1, **call)

    assert word in page.text("result", id=1)["error"]
    page.close()


@pytest.mark.parametrize(
    "message",
    [
        b"", b"\x00", b"\x01\x02", b"\x02" + b"\xff" * 20, b"\xff" * 1000,
        "", "null", "[]", "{", '{"op": "dance"}', '{"op": "subscribe"}', "[" * 5000,
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1, "maxHz": 0}]}',
        '{"op": "call", "id": 1e999, "method": "go"}', "x" * 300_000,
    ],
)  # fmt: skip
def test_garbage_is_answered_and_the_connection_goes_on(
    idle_console: Running, message: str | bytes
) -> None:
    page = idle_console.browser()

    page.socket.send(message)

    assert page.text("status", level=2)["message"]
    assert "no method" in page.call("nothing")["error"]
    page.close()


@pytest.mark.parametrize("name", ["a\x1b[2Jb", "a\u202eb", "a\nb"])
def test_name_of_an_operator_does_not_change_how_a_text_is_shown(
    idle_console: Running, name: str
) -> None:
    page = idle_console.browser()
    assert "name" in page.call("acquire_lease", robot="robot", name=name)["error"]
    assert "no robot" in page.call("acquire_lease", robot="robot", name="Zoë 2")["error"]
    page.close()


@pytest.mark.parametrize("topic", ["robot/scan", "//robot/scan", "/rosout", ""])
def test_message_on_a_topic_without_robot_is_refused(idle_console: Running, topic: str) -> None:
    client = idle_console.browser("foxglove.sdk.v1")
    channel = {"id": 1, "topic": topic, "encoding": "cdr", "schemaName": "std_msgs/msg/String"}
    client.send(op="advertise", channels=[channel])
    client.socket.send(struct.pack("<BI", 1, 1) + bytes(8))
    assert "no robot has this topic" in client.text("status", level=2)["message"]
    client.close()


def test_subscriptions_of_a_browser_are_limited(
    console: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hub_module, "MAX_SUBSCRIPTIONS", 2)
    console.call(console.hub.set_channels, [SCAN])
    page = console.browser()

    page.send(op="subscribe", subscriptions=[{"id": id_, "channelId": 1} for id_ in range(3)])

    assert "at most 2" in page.text("status", level=2)["message"]
    page.close()


def test_endless_garbage_closes_the_connection_with_the_reason(idle_console: Running) -> None:
    page = idle_console.browser()

    for _ in range(20):
        page.socket.send("garbage")
        page.text("status")
    page.socket.send("garbage")
    with pytest.raises(ConnectionClosed) as closed:
        page.text("none")

    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1008
    assert "invalid" in closed.value.rcvd.reason


async def _never(_: str | bytes) -> None:
    raise AssertionError("nothing is sent")
