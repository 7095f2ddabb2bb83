"""A base that is another program: zenoh-ros2-sdk, an independent client of rmw_zenoh, plays it."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cairn.bus.codec import Codec
from cairn.bus.plain import to_plain
from cairn.bus.qos import RELIABLE, SENSOR
from cairn.clock import from_ns
from cairn.deployment.load import load_deployment
from components.ros2_base.component import Ros2Base
from planar.messages import planar_pose, pose_message
from schemas.geometry_msgs import PoseWithCovariance, Twist, TwistStamped, Vector3
from schemas.message import type_name
from schemas.nav_msgs import Odometry
from schemas.std_msgs import Header
from tests.cairn.bus.network import Network, Reader, eventually
from tests.cairn.bus.test_interop import Ros2
from tests.cairn.component.running import Threaded

TOPICS = {
    "base_cmd_vel": "/cmd_vel",
    "base_cmd_vel_stamped": "/diff_drive_controller/cmd_vel",
    "base_odom": "/odom",
}
AHEAD = Twist(linear=Vector3(x=0.3), angular=Vector3(z=-0.2))
"""A command that the limits leave as it is."""


class ForeignBase:
    """The base: a ROS 2 node that takes both kinds of commands."""

    def __init__(self, ros2: Ros2) -> None:
        self._ros2 = ros2
        ros2.ask("advertise", topic="/odom", type=type_name(Odometry), node="base")
        for port, message in (("base_cmd_vel", Twist), ("base_cmd_vel_stamped", TwistStamped)):
            ros2.ask("subscribe", topic=TOPICS[port], type=type_name(message), node=f"hears_{port}")

    def tell(self, x: float) -> None:
        odometry = Odometry(
            header=Header(stamp=from_ns(time.time_ns()), frame_id="odom"),
            child_frame_id="base_link",
            pose=PoseWithCovariance(pose=pose_message((x, 1.0, 0.5))),
        )
        self._ros2.ask("publish", topic="/odom", value=to_plain(odometry))

    def hear(self, topic: str) -> Any:
        return self._ros2.ask("hear", topic=topic)


@pytest.fixture(scope="module")
def network() -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


@pytest.fixture(scope="module")
def base(network: Network, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForeignBase]:
    definitions = tmp_path_factory.mktemp("definitions")
    _write_definitions(definitions)
    program = str(Path(__file__).parents[2] / "cairn" / "bus" / "ros2_client.py")
    with subprocess.Popen(
        [sys.executable, program, str(network.port), str(definitions)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield ForeignBase(Ros2(process))
        finally:
            process.kill()


@pytest.mark.parametrize("stamped", [False, True], ids=["Twist", "TwistStamped"])
def test_it_is_driven_and_its_odometry_is_the_robots(
    network: Network, base: ForeignBase, stamped: bool
) -> None:
    name = f"base_{'stamped' if stamped else 'plain'}"
    bus = network.bus()
    node = bus.node("/robot/test", pytest.fail)
    odom = Reader(node, "/robot/odom", Odometry, RELIABLE.with_depth(100))
    command = node.advertise("/robot/cmd_vel", Twist, SENSOR)
    driver = Threaded(
        Ros2Base,
        network.bus(),
        name=name,
        topics=TOPICS,
        parameters={"stamped": stamped, "command_timeout_s": 5.0, "odom_timeout_s": 5.0},
    )
    driver.activate()
    try:

        def heard() -> bool:
            base.tell(0.25)
            return odom.subscription.take() is not None

        assert eventually(heard), "its odometry does not arrive"
        base.tell(0.5)
        assert eventually(lambda: _x(odom.subscription.take()) == pytest.approx(0.5))

        topic = TOPICS["base_cmd_vel_stamped" if stamped else "base_cmd_vel"]
        command.publish(AHEAD)
        assert eventually(lambda: _twist(base.hear(topic)) == to_plain(AHEAD))
        driver.ask("deactivate")
        assert eventually(lambda: _twist(base.hear(topic)) == to_plain(Twist()))
    finally:
        driver.close()


DEPLOYMENT = """
    cairn: 1
    robot: rover
    external_topics: [/odom, cmd_vel]
    components:
      base:
        plugin: ros2_base
        topics: {base_odom: /odom, base_cmd_vel: /cmd_vel}
    """


def test_a_deployment_names_its_topics(tmp_path: Path) -> None:
    file = tmp_path / "rover.yaml"
    file.write_text(DEPLOYMENT)

    load_deployment(file)


def _x(odom: Odometry | None) -> float:
    return float("nan") if odom is None else planar_pose(odom.pose.pose)[0]


def _twist(message: Any) -> Any:
    return message.get("twist", message)


def _write_definitions(directory: Path) -> None:
    """A .msg file for each message type that is used, as a ROS 2 installation has them."""
    codec = Codec()
    for message in (Odometry, Twist, TwistStamped):
        first, *others = codec.definition(message).split("=" * 80 + "\n")
        texts = {type_name(message): first}
        for other in others:
            title, _, text = other.partition("\n")
            package, name = title.removeprefix("MSG: ").split("/")
            texts[f"{package}/msg/{name}"] = text
        for name, text in texts.items():
            path = directory / f"{name}.msg"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
