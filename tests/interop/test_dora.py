"""Topics, services, actions and the graph are exchanged with dora-rs, in both directions.

dora-rs 1.1.0 has an implementation of rmw_zenoh in Rust, which its authors test against ROS 2.
"""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cairn import RELIABLE, SENSOR, Qos
from cairn.bus.actions import ActionCaller, make_at_once
from cairn.bus.bus import ServiceError
from cairn.bus.codec import to_plain
from cairn.bus.conflicts import qos_mismatch
from cairn.client import connect
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.message import type_name
from cairn.schemas.sensor_msgs import CameraInfo, Image, LaserScan
from cairn.schemas.sensor_msgs.msg import CompressedImage, Imu, PointCloud2
from tests.cairn.bus.network import Network, Reader, eventually, fail_test, node
from tests.cairn.bus.test_services import Calling, Serving, added
from tests.cairn.runtime.test_services_and_actions import Counter
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.interop.dora_process import Dora, dora_node
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes

MESSAGES = {
    "cmd_vel": Twist(linear=Vector3(x=0.25), angular=Vector3(z=-1.5)),
    "scan": LaserScan(angle_min=-0.5, angle_max=0.5, angle_increment=0.5, range_max=8.0,
                      ranges=[1.0, 2.5, 8.0]),  # type: ignore[arg-type]
    "imu": Imu(linear_acceleration=Vector3(z=9.81),
               angular_velocity_covariance=[0.5] * 9),  # type: ignore[arg-type]
    "cloud": PointCloud2(height=1, width=2, point_step=4, row_step=8,
                         data=[1, 2, 3, 4, 5, 6, 7, 8], is_dense=True),  # type: ignore[arg-type]
    "image": Image(height=1, width=2, encoding="rgb8", step=6,
                   data=[1, 2, 3, 4, 5, 6]),  # type: ignore[arg-type]
    "compressed": CompressedImage(format="jpeg", data=[255, 216, 255]),  # type: ignore[arg-type]
    "info": CameraInfo(width=640, height=480, distortion_model="plumb_bob",
                       d=[0.5] * 5, k=[1.0] * 9),  # type: ignore[arg-type]
}  # fmt: skip


@pytest.fixture
def network() -> Iterator[Network]:
    network = Network()
    try:
        yield network
    finally:
        network.close()


@pytest.fixture
def dora(network: Network, ament: Path, tmp_path: Path) -> Iterator[Dora]:
    with dora_node(network.endpoint, ament, tmp_path) as dora:
        yield dora


@pytest.mark.parametrize("name", list(MESSAGES))
def test_message_arrives_at_dora(network: Network, dora: Dora, name: str) -> None:
    message = MESSAGES[name]
    talker = node(network.bus(), "/robot/talker")
    publisher = talker.advertise(f"/robot/{name}", type(message), RELIABLE)
    dora.do("subscribe", topic=f"/robot/{name}", type=type_name(type(message)), reliable=True)
    assert eventually(lambda: publisher.has_subscribers)

    answers: list[Any] = []

    def received() -> bool:  # the first ones may be sent before the subscription is known there
        publisher.publish(message)
        answers.append(dora.do("receive", topic=f"/robot/{name}"))
        return answers[-1] is not None

    assert eventually(received)
    assert answers[-1] == to_plain(message)


@pytest.mark.accuracy
@pytest.mark.parametrize("name", list(MESSAGES))
def test_message_of_dora_arrives(network: Network, dora: Dora, name: str) -> None:
    message = MESSAGES[name]
    listener = node(network.bus(), "/robot/listener")
    reader = Reader(listener, f"/ros/{name}", type(message), SENSOR)
    arguments = {
        "topic": f"/ros/{name}", "type": type_name(type(message)), "value": to_plain(message),
        "reliable": False,
    }  # fmt: skip

    def received() -> bool:  # the first ones may be sent before the subscription is known there
        dora.do("publish", **arguments)
        time.sleep(0.05)
        return bool(reader.pending() and reader.subscription.received)

    assert eventually(received)
    dora.do("publish", **arguments)
    time.sleep(0.2)
    assert reader.pending()[-1:] == [message]
    assert reader.subscription.invalid == 0


def test_dora_calls_a_service(network: Network, dora: Dora) -> None:
    adder = node(network.bus(), "/robot/adder")
    serving = Serving(adder, "/robot/add")
    dora.do("service_client", name="/robot/add", type="example_interfaces/srv/AddTwoInts")

    def serve() -> None:
        for _ in range(3):
            call = serving.next()
            call.reply(added(call))

    thread = threading.Thread(target=serve)
    thread.start()
    answers = [dora.do("call", name="/robot/add", request={"a": 2, "b": b}) for b in (3, 4, -9)]
    thread.join(LIMIT_S)
    assert answers == [{"sum": 5}, {"sum": 6}, {"sum": -7}]


def test_dora_serves(network: Network, dora: Dora) -> None:
    dora.do("serve_sums", name="/ros/add")
    asker = node(network.bus(), "/robot/asker")
    calling = Calling(asker, "/ros/add")
    assert eventually(lambda: calling.client.is_available)
    for number in range(50):
        calling.call(AddTwoInts.Request(a=number, b=1))
    assert sorted(calling.next().sum for _ in range(50)) == list(range(1, 51))

    dora.kill()
    assert eventually(lambda: not calling.client.is_available)
    calling.call(AddTwoInts.Request())
    assert isinstance(calling.next(), ServiceError)


@pytest.fixture
def counter(network: Network) -> Iterator[ThreadedComponent]:
    component = ThreadedComponent(Counter, network.bus(), name="counter")
    component.request("configure")
    component.request("activate")
    yield component
    component.request("shutdown")


def test_dora_uses_an_action(dora: Dora, counter: ThreadedComponent) -> None:
    name = "/robot/fibonacci"
    dora.do("action_client", name=name, type="example_interfaces/action/Fibonacci")
    goal = dora.do("send_goal", name=name, goal={"order": 5})
    found = [dora.do("feedback", name=name, goal=goal, timeout_s=LIMIT_S) for _ in range(4)]
    assert [one["sequence"][-1] for one in found] == [1, 2, 3, 5]
    assert dora.do("result", name=name, goal=goal) == [
        "succeeded", {"sequence": [0, 1, 1, 2, 3, 5]},
    ]  # fmt: skip
    assert dora.do("send_goal", name=name, goal={"order": -1}) is None

    long = dora.do("send_goal", name=name, goal={"order": 50})
    dora.do("feedback", name=name, goal=long, timeout_s=LIMIT_S)
    assert dora.do("cancel", name=name, goal=long) == 0
    assert eventually(lambda: not counter.runtime.component.fibonacci.goals)  # type: ignore[attr-defined]
    assert dora.do("send_goal", name=name, goal={"order": 2}) is not None


def test_dora_serves_an_action(network: Network, dora: Dora) -> None:
    dora.do("serve_fibonacci", name="/ros/fibonacci")
    asker = node(network.bus(), "/robot/asker")
    caller = ActionCaller(
        "/ros/fibonacci", Fibonacci, lambda name, kind: asker.client(name, kind, make_at_once)
    )

    def receive() -> None:
        message = feedback.take()
        if message is not None:
            caller.receive_feedback(message)

    feedback = asker.subscribe(
        caller.feedback_topic, Fibonacci.FeedbackMessage, RELIABLE.with_depth(100), receive
    )
    assert eventually(lambda: caller.is_available)

    sent = caller.send(os.urandom(16), Fibonacci.Goal(order=4), LIMIT_S)
    assert eventually(lambda: sent.has_ended)
    assert (sent.status, sent.error) == (GoalStatus.STATUS_SUCCEEDED, None)
    assert sent.result is not None
    assert sent.result.sequence.tolist() == [0, 1, 1, 2, 3]
    assert eventually(lambda: len(sent.feedback) == 3)

    sent = caller.send(os.urandom(16), Fibonacci.Goal(order=400), LIMIT_S)
    assert eventually(lambda: len(sent.feedback) > 1)
    sent.cancel()
    assert eventually(lambda: sent.has_ended and sent.cancel_code is not None)
    assert (sent.status, sent.cancel_code) == (GoalStatus.STATUS_CANCELED, 0)

    sent = caller.send(os.urandom(16), Fibonacci.Goal(order=400), LIMIT_S)
    assert eventually(lambda: sent.is_accepted)
    dora.kill()
    assert eventually(lambda: sent.has_ended)
    assert "the server ended" in str(sent.error)


def test_dora_is_a_foreign_node_with_what_it_uses(network: Network, dora: Dora) -> None:
    dora.do("serve_sums", name="/ros/add")
    dora.do("serve_fibonacci", name="/ros/fibonacci")
    dora.do("subscribe", topic="/robot/scan", type="sensor_msgs/msg/LaserScan", reliable=True)
    wanted = {
        "service server": ["/ros/add"],
        "action server": ["/ros/fibonacci"],
        "subscriber": ["/robot/scan"],
    }

    with connect(network.endpoint, 0) as robot:

        def found() -> bool:
            nodes = [one for one in robot.nodes() if one.name == "/ros/dora" and one.is_foreign]
            return any(
                all(one.names(role) == names for role, names in wanted.items())  # type: ignore[arg-type]
                for one in nodes
            )

        assert eventually(found)
        [action] = robot.actions()
        assert (action.servers, action.foreign) == (("/ros/dora",), ("/ros/dora",))


def test_mismatch_with_dora_is_a_warning_and_messages_arrive(network: Network, dora: Dora) -> None:
    message = MESSAGES["scan"]
    warned: list[str] = []
    talker = network.bus().node("/robot/talker", fail_test, warned.append)
    publisher = talker.advertise("/robot/scan", type(message), SENSOR)
    dora.do("subscribe", topic="/robot/scan", type="sensor_msgs/msg/LaserScan", reliable=True)
    requested = Qos("reliable", "volatile", 10)

    assert eventually(
        lambda: (
            warned == [qos_mismatch("/robot/scan", "/robot/talker", SENSOR, "/ros/dora", requested)]
        )
    )
    assert eventually(lambda: publisher.has_subscribers)

    def received() -> bool:
        publisher.publish(message)
        return bool(dora.do("receive", topic="/robot/scan") == to_plain(message))

    assert eventually(received)


def test_dora_and_ours_use_one_rule_for_the_domain(
    network: Network, ament: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nodes(domain: int | None) -> list[str]:
        with connect(network.endpoint, domain) as robot:
            return [one.name for one in robot.nodes()]

    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    with dora_node(network.endpoint, ament, tmp_path) as dora:
        dora.do("serve_sums", name="/ros/add")
        assert eventually(lambda: nodes(None) == ["/ros/dora"])
        assert nodes(0) == []
