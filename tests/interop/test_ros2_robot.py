"""A robot whose drivers are ROS 2 nodes, with Cairn's navigation: `deploy/robot_ros2.yaml`.

Base and scanner are nodes of dora-rs. They are fed by a simulated robot, which the deployment's
components know only by these nodes.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.interop.dora_process import Dora, dora_node
from tests.interop.test_dora_navigation import ACTION, goal
from tests.navigation.driving import SIM
from tests.navigation.processes import ObservedRobot, robot_in

pytestmark = [pytest.mark.xdist_group("robots in real time"), pytest.mark.processes]

OVERLAYS = (
    SIM.with_name("robot_ros2.yaml"),
    SIM.with_name("robot_without_camera.yaml"),
    Path(__file__).with_name("plant.yaml"),
)


@contextmanager
def drivers(robot: ObservedRobot, ament: Path, folder: Path, name: str) -> Iterator[Dora]:
    """Run a node that drives the simulated robot: its scanner and its base."""
    with dora_node(robot.run.endpoint, ament, folder, name) as dora:
        for source, target, kind, reliable in (
            ("/plant/scan", "/scan", "sensor_msgs/msg/LaserScan", False),
            ("/plant/odom", "/odom", "nav_msgs/msg/Odometry", True),
            ("/cmd_vel", "/plant/cmd_vel", "geometry_msgs/msg/Twist", True),
        ):
            dora.do("relay", source=source, target=target, type=kind, reliable=reliable)
        yield dora


def test_robot_reaches_a_goal_although_its_drivers_are_killed(tmp_path: Path, ament: Path) -> None:
    with (
        robot_in(
            tmp_path,
            "bus.listen=[]",
            "bus.allow_any_local_user=false",
            f"world={SIM.parent / 'worlds' / 'room.yaml'}",
            deployment=SIM.with_name("robot.yaml"),
            overlays=OVERLAYS,
            until="child active: plant_scanner",
        ) as robot,
        dora_node(robot.run.endpoint, ament, tmp_path, "operator") as operator,
    ):
        operator.do("action_client", name=ACTION, type="nav2_msgs/action/NavigateToPose")
        with drivers(robot, ament, tmp_path, "drivers") as first:
            sent = operator.do("send_goal", name=ACTION, goal=goal(3.6, 1.2))
            robot.await_moved(0.5)
            lines = [robot.run.await_line(f"arrives again on {one}") for one in ("/odom", "/scan")]
            first.kill()
            robot.await_stand()
            for topic, after in zip(("/odom", "/scan"), lines, strict=True):
                silent = f"does not arrive on {topic}; check that its node runs"
                robot.run.await_line(silent, after=after)
        with drivers(robot, ament, tmp_path, "drivers_again"):
            assert operator.do("result", name=ACTION, goal=sent) == [
                "succeeded", {"error_code": 0, "error_msg": ""},
            ]  # fmt: skip
            assert robot.pose[:2] == pytest.approx((3.6, 1.2), abs=0.15)
            assert robot.collisions == []
