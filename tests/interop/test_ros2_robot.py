"""A robot whose drivers are ROS 2 nodes, with Cairn's navigation: `deploy/robot_ros2.yaml`.

Base, scanner and stereo camera are nodes of dora-rs. They are fed by a simulated robot, which the
deployment's components know only by these nodes.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cairn import RELIABLE
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.cairn_msgs import RecognizedObjectArray
from tests.cairn.bus.network import Reader, node
from tests.interop.dora_process import Dora, dora_node
from tests.interop.test_dora_navigation import goal
from tests.navigation.driving import SIM
from tests.navigation.processes import ObservedRobot, robot_in

pytestmark = [pytest.mark.realtime, pytest.mark.processes, pytest.mark.accuracy]

ACTION = "/navigate_to_pose"  # as with Nav2, by `ros_names`
RELAYS = (
    ("/plant/scan", "/scan", "sensor_msgs/msg/LaserScan", False),
    ("/plant/odom", "/odom", "nav_msgs/msg/Odometry", True),
    ("/cmd_vel", "/plant/cmd_vel", "geometry_msgs/msg/Twist", True),
    *(
        (f"/plant/{side}/{name}", f"/{side}/{name}", f"sensor_msgs/msg/{kind}", False)
        for side in ("left", "right")
        for name, kind in (("image_raw", "Image"), ("camera_info", "CameraInfo"))
    ),
)


@contextmanager
def drivers(robot: ObservedRobot, ament: Path, folder: Path, name: str) -> Iterator[Dora]:
    """Run a node that drives the simulated robot: its scanner, base and cameras."""
    with dora_node(robot.run.endpoint, ament, folder, name) as dora:
        for source, target, kind, reliable in RELAYS:
            dora.do("relay", source=source, target=target, type=kind, reliable=reliable)
        yield dora


def test_robot_reaches_a_goal_although_its_drivers_are_killed(tmp_path: Path, ament: Path) -> None:
    with (
        robot_in(
            tmp_path,
            "bus.listen=[]",
            "ros_names=true",
            "bus.allow_any_local_user=false",
            f"world={SIM.parent / 'worlds' / 'room.yaml'}",
            deployment=SIM.with_name("robot.yaml"),
            overlays=(SIM.with_name("robot_ros2.yaml"), Path(__file__).with_name("plant.yaml")),
            until="child active: ros_names",
        ) as robot,
        dora_node(robot.run.endpoint, ament, tmp_path, "operator") as operator,
    ):
        operator.do("action_client", name=ACTION, type="nav2_msgs/action/NavigateToPose")
        with drivers(robot, ament, tmp_path, "drivers") as first:
            target = goal(1.6, 2.5)
            target["pose"]["pose"]["orientation"] = {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}
            sent = operator.do("send_goal", name=ACTION, goal=target)
            robot.await_moved(0.5)
            topics = ("/odom", "/scan")
            lines = [robot.run.await_line(f"arrives again on {topic}") for topic in topics]
            first.kill()
            robot.await_stand()
            for topic, after in zip(topics, lines, strict=True):
                silent = f"does not arrive on {topic}; check that its node runs"
                robot.run.await_line(silent, after=after)
        with drivers(robot, ament, tmp_path, "drivers_again"):
            assert operator.do("result", name=ACTION, goal=sent) == [
                "succeeded", {"error_code": 0, "error_msg": ""},
            ]  # fmt: skip
            assert robot.pose[:2] == pytest.approx((1.6, 2.5), abs=0.15)
            assert robot.collisions == []
            assert recognizes(robot, 1), "which it faces now"


def recognizes(robot: ObservedRobot, number: int) -> bool:
    """Return whether an object is recognized in one of the next 100 images."""
    bus = ZenohBus(open_peer([robot.run.endpoint]))
    try:
        witness = node(bus, "/witness")
        objects = Reader(witness, "/robot/recognized_objects", RecognizedObjectArray, RELIABLE)
        found = (objects.next().objects for _ in range(100))
        return any(number in {one.object_id for one in several} for several in found)
    finally:
        bus.close()
