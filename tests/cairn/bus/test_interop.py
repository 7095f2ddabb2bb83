"""Topics, services and the graph are exchanged with zenoh-ros2-sdk, independent of rmw_zenoh."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any, ClassVar

import pytest

from cairn import RELIABLE, SENSOR, ActionServer, Component, In, Out, ServerGoal, goal, on
from cairn.bus.codec import to_plain
from cairn.bus.keys import EndpointEntity, NodeEntity
from cairn.bus.type_hash import type_hash
from cairn.client import connect
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.geometry_msgs import Point, Pose, PoseWithCovariance, Twist, Vector3
from cairn.schemas.message import type_name
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rcl_interfaces.msg import ParameterType
from cairn.schemas.rcl_interfaces.srv import GetParameters, GetParameterTypes
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header, String
from cairn.testing.launching import free_port
from tests.cairn.bus.network import Network, eventually, node
from tests.cairn.bus.ros2 import Ros2, ros2_node, write_service_definitions
from tests.cairn.bus.test_services import Calling
from tests.cairn.runtime.test_services_and_actions import Adder
from tests.cairn.runtime.threaded import ThreadedComponent

pytestmark = pytest.mark.processes


HEADER = Header(stamp=Time(sec=1_700_000_000, nanosec=5), frame_id="base_link")
MESSAGES: dict[str, Any] = {
    "word": String(data="Grüße, 世界"),
    "cmd_vel": Twist(linear=Vector3(x=0.25), angular=Vector3(z=-1.5)),
    "scan": LaserScan(
        header=HEADER, angle_min=-0.5, angle_max=0.5, angle_increment=0.5, range_min=0.25,
        range_max=8.0, ranges=[1.0, 2.5, 8.0], intensities=[0.5, 0.25, 0.0],  # type: ignore[arg-type]
    ),
    "odom": Odometry(
        header=HEADER,
        child_frame_id="base_link",
        pose=PoseWithCovariance(
            pose=Pose(position=Point(x=1.0, y=-2.0)),
            covariance=[float(number) for number in range(36)],  # type: ignore[arg-type]
        ),
    ),
    "objects": RecognizedObjectArray(
        header=HEADER,
        objects=(
            RecognizedObject(
                object_id=7, range=2.0, bearing=-0.5, covariance=[0.25, 0.0, 0.0, 0.125],  # type: ignore[arg-type]
                inliers=40,
            ),
            RecognizedObject(object_id=8, range=1.0, bearing=0.5),
        ),
    ),
}  # fmt: skip


NODES = {"/robot/base"} | {
    f"/ros/{role}_{topic}" for topic in MESSAGES for role in ("talker", "listener")
}


class Robot(Component):
    """A component that receives and publishes each of the messages."""

    word: In[String]
    cmd_vel: In[Twist]
    scan: In[LaserScan] = In(qos=SENSOR)
    odom: In[Odometry]
    objects: In[RecognizedObjectArray]
    out_word: Out[String]
    out_cmd_vel: Out[Twist]
    out_scan: Out[LaserScan] = Out(qos=SENSOR)
    out_odom: Out[Odometry]
    out_objects: Out[RecognizedObjectArray]
    count: ActionServer[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]

    received: ClassVar[dict[str, Any]] = {}

    @goal("count")
    def on_goal(self, _: ServerGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]) -> None:
        """Accept it; only the graph is tested."""

    @on("word")
    def on_word(self, message: String) -> None:
        self.received["word"] = message

    @on("cmd_vel")
    def on_cmd_vel(self, message: Twist) -> None:
        self.received["cmd_vel"] = message

    @on("scan")
    def on_scan(self, message: LaserScan) -> None:
        self.received["scan"] = message

    @on("odom")
    def on_odom(self, message: Odometry) -> None:
        self.received["odom"] = message

    @on("objects")
    def on_objects(self, message: RecognizedObjectArray) -> None:
        self.received["objects"] = message


@pytest.fixture(scope="module")
def port() -> int:
    """The TCP port of the router: the other client has no Unix sockets."""
    return free_port()


@pytest.fixture(scope="module")
def network(port: int) -> Iterator[Network]:
    network = Network(f"tcp/127.0.0.1:{port}")
    yield network
    network.close()


@pytest.fixture(scope="module")
def ros2(network: Network, port: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros2]:
    definitions = tmp_path_factory.mktemp("definitions")
    write_service_definitions(definitions, (AddTwoInts, GetParameters, GetParameterTypes))
    with ros2_node(port, definitions, map(type, MESSAGES.values())) as ros2:
        for topic, message in MESSAGES.items():
            name = type_name(type(message))
            ros2.request("advertise", topic=f"/robot/{topic}", type=name, node=f"talker_{topic}")
            ros2.request(
                "subscribe", topic=f"/robot/out_{topic}", type=name, node=f"listener_{topic}"
            )
        yield ros2


@pytest.fixture(scope="module")
def robot(network: Network, ros2: Ros2) -> Iterator[ThreadedComponent]:
    bus = network.bus()
    robot = ThreadedComponent(Robot, bus, name="base")
    robot.activate()
    yield robot
    robot.close()


@pytest.fixture(scope="module")
def known(network: Network, robot: ThreadedComponent, ros2: Ros2) -> Network:
    """Wait until both know all declarations; the other client has no barrier.

    That an endpoint is in the graph does not yet mean that messages reach it.
    """
    outputs = [getattr(robot.runtime.component, f"out_{topic}") for topic in MESSAGES]
    assert eventually(lambda: all(output.has_subscribers for output in outputs))
    inputs = [f"/robot/{topic}" for topic in MESSAGES]
    assert eventually(lambda: all(ros2.request("has_subscribers", topic=name) for name in inputs))
    topics = {f"/robot/{prefix}{topic}" for topic in MESSAGES for prefix in ("", "out_")}
    assert eventually(lambda: topics <= {name for name, _ in ros2.request("topics")})
    assert eventually(lambda: nodes(network) >= NODES)
    return network


def nodes(network: Network) -> set[str]:
    return {one.name for one in network.graph() if isinstance(one, NodeEntity)}


@pytest.mark.parametrize("topic", list(MESSAGES))
def test_message_of_a_ros2_client_reaches_a_port(
    known: Network, robot: ThreadedComponent, ros2: Ros2, topic: str
) -> None:
    ros2.request("publish", topic=f"/robot/{topic}", value=to_plain(MESSAGES[topic]))

    assert eventually(lambda: topic in Robot.received)
    assert Robot.received[topic] == MESSAGES[topic]


@pytest.mark.parametrize("topic", list(MESSAGES))
def test_message_of_a_port_reaches_a_ros2_client(
    known: Network, robot: ThreadedComponent, ros2: Ros2, topic: str
) -> None:
    port: Out[Any] = getattr(robot.runtime.component, f"out_{topic}")
    port.publish(MESSAGES[topic])

    assert ros2.request("receive", topic=f"/robot/out_{topic}") == to_plain(MESSAGES[topic])


def test_ros2_client_calls_services_of_a_component(network: Network, ros2: Ros2) -> None:
    adder = ThreadedComponent(Adder, network.bus(), name="adder")
    adder.activate()
    try:
        types = "/robot/adder/get_parameter_types"
        for name, service in (
            ("/robot/add", AddTwoInts),
            (types, GetParameterTypes),
            ("/robot/adder/get_parameters", GetParameters),  # found by the hash of nested types
        ):
            caller = f"caller_{service.__name__.lower()}"
            ros2.request("service_client", name=name, type=type_name(service), node=caller)
            assert eventually(lambda name=name: ros2.request("has_server", name=name))  # type: ignore[misc]

        def add(a: int) -> Any:
            return ros2.request("call", name="/robot/add", request={"a": a, "b": 3})

        assert add(2) == {"sum": 5}
        assert add(-1) is None, "refused, with an error reply that the client logs"
        assert add(7) == {"sum": 10}
        answer = ros2.request("call", name=types, request={"names": ["log_level", "other"]})
        assert answer == {
            "types": [ParameterType.PARAMETER_STRING, ParameterType.PARAMETER_NOT_SET]
        }
    finally:
        adder.close()


def test_service_of_a_ros2_client_is_called(network: Network, ros2: Ros2) -> None:
    ros2.request("serve_sums", name="/ros/sums", node="sums")
    with closing(node(network.bus(), "/robot/asker")) as asker:
        calling = Calling(asker, "/ros/sums")
        assert eventually(lambda: calling.client.is_available)

        for number in range(50):
            calling.call(AddTwoInts.Request(a=number, b=1))
        assert sorted(calling.next().sum for _ in range(50)) == list(range(1, 51))


def test_messages_of_a_ros2_client_are_neither_invalid_nor_dropped(
    known: Network, robot: ThreadedComponent
) -> None:
    ports = {port.port: port for port in robot.runtime.status().ports}

    assert all((port.dropped, port.invalid) == (0, 0) for port in ports.values())


def test_nodes_of_a_ros2_client_are_in_our_graph(known: Network) -> None:
    assert nodes(known) >= NODES
    (talker,) = (
        one
        for one in known.graph()
        if isinstance(one, EndpointEntity) and one.node.name == "/ros/talker_scan"
    )
    assert (talker.kind, talker.topic, talker.qos) == ("MP", "/robot/scan", RELIABLE)
    assert talker.type_name == "sensor_msgs/msg/LaserScan"
    assert talker.type_hash == type_hash(LaserScan)


def test_our_node_is_in_the_graph_of_a_ros2_client(known: Network, ros2: Ros2) -> None:
    # zenoh 1.10 now and then answers a peer with nothing, so it has to ask again.
    types = {f"/robot/{name}": [type_name(type(one))] for name, one in MESSAGES.items()}
    assert eventually(lambda: types.items() <= dict(ros2.request("topics")).items())
    scan = {
        "publishers": [["/ros", "talker_scan", "::,10:,:,:,,"]],
        "subscribers": [["/robot", "base", "2::,5:,:,:,,"]],
    }
    assert eventually(lambda: ros2.request("info", topic="/robot/scan") == scan)


def test_our_services_and_actions_are_in_the_graph_of_a_ros2_client(
    known: Network, ros2: Ros2
) -> None:
    services = {
        "/robot/base/get_parameters": "rcl_interfaces/srv/GetParameters",
        "/robot/count/_action/send_goal": "example_interfaces/action/Fibonacci_SendGoal",
        "/robot/count/_action/cancel_goal": "action_msgs/srv/CancelGoal",
        "/robot/count/_action/get_result": "example_interfaces/action/Fibonacci_GetResult",
    }
    found = {name: [kind] for name, kind in services.items()}
    assert eventually(lambda: found.items() <= dict(ros2.request("services")).items())
    server = ["/robot", "base", type_hash(GetParameters), "::,10:,:,:,,"]
    assert eventually(
        lambda: ros2.request("servers", service="/robot/base/get_parameters") == [server]
    )
    topics = {
        "/robot/count/_action/feedback": ["example_interfaces/action/Fibonacci_FeedbackMessage"],
        "/robot/count/_action/status": ["action_msgs/msg/GoalStatusArray"],
    }
    assert eventually(lambda: topics.items() <= dict(ros2.request("topics")).items())


def test_nodes_of_a_ros2_client_are_foreign_nodes_of_ours(known: Network) -> None:
    with connect(known.endpoint, 0) as robot:
        nodes = {one.name: one for one in robot.nodes()}
        scan = next(one for one in robot.topics() if one.name == "/robot/scan")

    assert [name for name, one in nodes.items() if not one.is_foreign] == ["/robot/base"]
    assert nodes["/ros/talker_scan"].names("publisher") == ["/robot/scan"]
    assert nodes["/ros/listener_scan"].names("subscriber") == ["/robot/out_scan"]
    assert nodes["/robot/base"].names("action server") == ["/robot/count"]
    assert (scan.publishers, scan.foreign) == (("/ros/talker_scan",), ("/ros/talker_scan",))
    assert scan.problems == ()
