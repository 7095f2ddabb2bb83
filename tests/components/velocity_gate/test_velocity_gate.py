"""The velocity gate as a component: sources, lease, emergency stop, obstacles."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import CairnError, ParameterRejected, from_ns
from cairn.components.velocity_gate.component import VelocityGate
from cairn.planar.messages import pose_message
from cairn.planar.poses import Pose, compose
from cairn.schemas.cairn_nav_msgs import ReasonCode, TeleoperationCommand, VelocityGateStatus
from cairn.schemas.geometry_msgs import PoseWithCovariance, Twist, TwistWithCovariance, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Bool, Header
from cairn.testing.lockstep import ComponentHarness
from tests.sweeps import sampled

AHEAD = Twist(linear=Vector3(x=0.4))


class GatedRobot:
    """The gate, and an ideal base that follows it; points [m] are what the scanner sees."""

    def __init__(self, *, restarts: int = 0, **parameters: Any) -> None:
        self.gate = ComponentHarness(VelocityGate, parameters, start_s=100.0, restarts=restarts)
        self.pose: Pose = (0.0, 0.0, 0.0)
        self.points = np.empty((0, 2))
        self.command = (0.0, 0.0)
        self.scans = True
        self.odometry_late_s = 0.0
        self.gap = math.inf
        self._delayed: list[tuple[int, Odometry]] = []
        self._tick = 0

    @property
    def status(self) -> VelocityGateStatus:
        """The newest status."""
        status = self.gate.component._status
        assert isinstance(status, VelocityGateStatus)
        return status

    def step(self, *messages: tuple[str, Any], seconds: float = 0.02) -> None:
        """Let time pass, with these messages every 20 ms."""
        for _ in range(round(seconds / 0.02)):
            self._sense()
            for topic, message in messages:
                self.gate.publish(topic, message)
            self.gate.run_for(0.02)
            for twist in self.gate.take("cmd_vel"):
                self.command = (twist.linear.x, twist.angular.z)
            speed, turn = self.command
            self.pose = compose(self.pose, (0.02 * speed, 0.0, 0.02 * turn))
            if self.points.shape[0]:
                apart = np.hypot(*(self.points - self.pose[:2]).T)
                self.gap = min(self.gap, float(apart.min()) - 0.22)

    def teleoperate(self, lease: int, speed: float, age_s: float = 0.0) -> TeleoperationCommand:
        """Return a command of an operator."""
        stamp = from_ns(self.gate.now_ns - round(age_s * 1e9))
        return TeleoperationCommand(
            header=Header(stamp=stamp), lease=lease, twist=Twist(linear=Vector3(x=speed))
        )

    def _sense(self) -> None:
        stamp = from_ns(self.gate.now_ns)
        twist = Twist(linear=Vector3(x=self.command[0]), angular=Vector3(z=self.command[1]))
        odometry = Odometry(
            header=Header(stamp=stamp, frame_id="odom"),
            child_frame_id="base_link",
            pose=PoseWithCovariance(pose=pose_message(self.pose)),
            twist=TwistWithCovariance(twist=twist),
        )
        due = self.gate.now_ns + round(self.odometry_late_s * 1e9)
        self._delayed.append((due, odometry))
        for one in [one for one in self._delayed if one[0] <= self.gate.now_ns]:
            self._delayed.remove(one)
            self.gate.publish("odom", one[1])
        if self.scans and self._tick % 5 == 0:
            self.gate.publish("scan", self._scan(stamp))
        self._tick += 1

    def _scan(self, stamp: Any) -> LaserScan:
        angles = np.linspace(-0.75 * math.pi, 0.75 * math.pi, 541)
        ranges = np.full(angles.size, np.inf)
        x, y, theta = self.pose
        for px, py in self.points:
            apart = math.hypot(px - x, py - y)
            bearing = (math.atan2(py - y, px - x) - theta + math.pi) % (2 * math.pi) - math.pi
            near = np.abs(angles - bearing) < 0.01 + 0.02 / max(apart, 0.05)
            ranges[near] = np.minimum(ranges[near], apart)
        return LaserScan(
            header=Header(stamp=stamp, frame_id="laser"),
            angle_min=float(np.float32(angles[0])),
            angle_max=float(np.float32(angles[-1])),
            angle_increment=float(np.float32(angles[1] - angles[0])),
            range_max=10.0,
            ranges=ranges.astype(np.float32),
        )


@pytest.mark.parametrize(
    ("parameters", "corners", "reach"),
    [
        ({"radius": 0.3}, 32, 0.3),
        ({"footprint": [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]}, 4, 0.5),
    ],
)
def test_outline_of_the_robot_is_published(
    parameters: dict[str, Any], corners: int, reach: float
) -> None:
    robot = GatedRobot(**parameters)

    (outline,) = robot.gate.take("footprint")

    assert outline.header.frame_id == "base_link"
    points = [(point.x, point.y) for point in outline.polygon.points]
    assert len(points) == corners
    assert [math.hypot(*point) for point in points] == pytest.approx([reach] * corners)


def test_command_passes_and_ceases_with_its_source() -> None:
    robot = GatedRobot()
    robot.step(("navigator_cmd_vel", AHEAD), seconds=1.0)
    assert robot.command == (0.4, 0.0)
    assert robot.status.source == "navigator"

    robot.step(seconds=0.8)

    assert robot.command == (0.0, 0.0)
    assert robot.status.source == ""


def test_obstacle_counts_at_once_although_odometry_is_late() -> None:
    robot = GatedRobot()
    robot.odometry_late_s = 0.24
    robot.step(("navigator_cmd_vel", AHEAD), seconds=2.0)
    assert robot.command == (0.4, 0.0)
    while robot._tick % 5:
        robot.step(("navigator_cmd_vel", AHEAD), seconds=0.02)

    # The next scan shows it; the odometry of its time arrives 0.24 s later.
    robot.points = np.array([[robot.pose[0] + 0.22 + 0.1, 0.0]])
    robot.step(("navigator_cmd_vel", AHEAD), seconds=0.04)

    assert robot.command[0] < 0.25
    robot.step(("navigator_cmd_vel", AHEAD), seconds=2.0)
    assert robot.gap > 0.0


def test_points_are_remembered_where_they_are_although_odometry_is_late() -> None:
    robot = GatedRobot()
    robot.odometry_late_s = 0.24
    bearings = np.linspace(-2.0, 2.0, 9)
    robot.points = 1.0 * np.column_stack((np.cos(bearings), np.sin(bearings)))
    turn = Twist(angular=Vector3(z=1.5))
    robot.step(("navigator_cmd_vel", Twist()), seconds=1.0)
    robot.step(("navigator_cmd_vel", turn), seconds=0.5)  # it accelerates

    x, y = robot.gate.component._scans.points((0.0, 0.0, 0.0), 5.0).T

    assert robot.command[1] > 1.0
    aside = np.abs(np.arctan2(y, x)[:, None] - bearings).min(axis=1)
    assert len(x) >= 9
    assert aside.max() < 0.03 + 0.03  # half the width of a point in a scan


def speed_before_an_obstacle(late_s: float) -> float:
    """Return the command 0.35 m before an obstacle, with odometry that old."""
    robot = GatedRobot()
    robot.odometry_late_s = late_s
    robot.points = np.array([[2.0, 0.0]])
    while robot.gap > 0.35:
        robot.step(("navigator_cmd_vel", Twist(linear=Vector3(x=0.6))), seconds=0.02)
    return robot.command[0]


def test_robot_approaches_obstacles_more_slowly_the_older_odometry_is() -> None:
    prompt, nearly, late = (speed_before_an_obstacle(age_s) for age_s in (0.0, 0.08, 0.26))

    assert nearly == pytest.approx(prompt, abs=0.03)
    assert 0.05 < late < prompt - 0.04


def test_robot_with_late_odometry_stops_before_an_obstacle() -> None:
    robot = GatedRobot()
    robot.odometry_late_s = 0.28
    robot.points = np.array([[2.0, 0.0]])

    robot.step(("navigator_cmd_vel", Twist(linear=Vector3(x=0.6))), seconds=8.0)

    assert 0.0 < robot.gap < 0.1


def test_robot_stands_without_scans_and_names_the_topic() -> None:
    robot = GatedRobot()
    robot.step(("navigator_cmd_vel", AHEAD), seconds=1.0)
    robot.scans = False
    robot.step(("navigator_cmd_vel", AHEAD), seconds=0.7)
    assert robot.command == (0.0, 0.0)
    assert robot.status.reason_code == ReasonCode.NO_SCAN
    assert "scan" in robot.status.reason


def test_operator_with_the_lease_drives_and_others_are_refused() -> None:
    robot = GatedRobot()
    robot.step(seconds=0.2)
    lease = robot.gate.request("acquire_lease", operator="anna", seconds=2.0)["lease"]
    with pytest.raises(CairnError, match="held by anna"):
        robot.gate.request("acquire_lease", operator="bert", seconds=2.0)

    for _ in range(25):
        robot.step(
            ("teleoperation", robot.teleoperate(lease + 1, 0.3)),
            ("navigator_cmd_vel", AHEAD),
        )
    assert robot.command == (0.0, 0.0)  # the robot is reserved for the operator
    assert robot.status.operator == "anna"

    robot.step(("teleoperation", robot.teleoperate(lease, 0.2, age_s=0.5)))
    for _ in range(25):
        robot.step(("teleoperation", robot.teleoperate(lease, 0.2)))
    assert robot.command == pytest.approx((0.2, 0.0))
    assert robot.status.refused_lease == 25
    assert robot.status.refused_late == 1

    robot.step(("navigator_cmd_vel", AHEAD), seconds=2.0)
    assert robot.status.operator == ""  # expired by itself
    assert robot.status.source == "navigator"

    taken = robot.gate.request("take_over_lease", operator="bert", seconds=2.0)["lease"]
    robot.gate.request("release_lease", lease=taken)
    with pytest.raises(CairnError, match="acquire it again"):
        robot.gate.request("renew_lease", lease=lease, seconds=2.0)


def test_emergency_stop_is_latched_and_survives_a_restart(tmp_path: Path) -> None:
    file = tmp_path / "gate.json"
    robot = GatedRobot(state_file=str(file))
    robot.step(("navigator_cmd_vel", AHEAD), seconds=1.0)
    robot.gate.publish("emergency_stop", Bool(data=True))
    robot.gate.publish("emergency_stop", Bool(data=False))
    robot.step(("navigator_cmd_vel", AHEAD), seconds=0.02)
    assert robot.command == (0.0, 0.0)

    again = GatedRobot(state_file=str(file), restarts=1)
    again.step(("navigator_cmd_vel", AHEAD), seconds=1.0)
    assert again.command == (0.0, 0.0)
    assert again.status.reason_code == ReasonCode.EMERGENCY_STOP

    assert again.gate.request("release_stop")["emergency_stop"] is False
    again.step(("navigator_cmd_vel", AHEAD), seconds=1.0)
    assert again.command == (0.4, 0.0)
    assert json.loads(file.read_text())["engaged"] is False


@pytest.mark.parametrize("content", [None, "", "[[[", '{"engaged": 0}'])
def test_unknown_state_of_the_emergency_stop_counts_as_engaged(
    tmp_path: Path, content: str | None
) -> None:
    file = tmp_path / "gate.json"
    if content is not None:
        file.write_text(content)
    robot = GatedRobot(state_file=str(file), restarts=1)
    robot.step(("navigator_cmd_vel", AHEAD), seconds=0.5)
    assert robot.command == (0.0, 0.0)
    assert robot.status.emergency_stop


def test_pipe_in_place_of_the_file_counts_as_engaged_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "gate.json")

    robot = GatedRobot(state_file=str(tmp_path / "gate.json"))

    assert "cannot be read" in robot.gate.request("status")["reason"]


@pytest.mark.parametrize(
    "changes", [{"scanner": False}, {"external.enabled": True}, {"speed": 3.0}, {"braking": 10.0}]
)
def test_limits_cannot_be_changed_by_a_request(changes: dict[str, Any]) -> None:
    robot = GatedRobot()
    before = robot.gate.component.config

    with pytest.raises(ParameterRejected, match="cannot change while it runs"):
        robot.gate.set_parameters(changes)

    assert robot.gate.component.config == before


def test_status_for_people_names_source_operator_and_what_holds_the_robot() -> None:
    robot = GatedRobot()

    def state() -> str:
        return robot.gate.runtime.status().reason

    robot.step(("navigator_cmd_vel", AHEAD), seconds=0.6)
    assert state() == "navigator drives"
    robot.step(("navigator_cmd_vel", Twist()), seconds=2.0)
    assert state() == "navigator commands standstill"
    robot.points = np.array([[robot.pose[0] + 0.3, 0.0]])
    robot.step(("navigator_cmd_vel", AHEAD), seconds=1.5)
    assert state().startswith("holds navigator: an obstacle")
    robot.gate.request("acquire_lease", operator="anna", seconds=2.0)
    robot.gate.request("stop", reason="test")
    assert state() == "emergency stop: test; anna has the operator's lease"


def test_external_source_can_be_enabled_without_giving_priorities() -> None:
    robot = GatedRobot(external={"enabled": True}, teleoperation={"timeout": 0.5})
    robot.step(("external_cmd_vel", AHEAD), ("navigator_cmd_vel", Twist()), seconds=1.0)
    assert robot.command == (0.4, 0.0)


def test_pressed_button_cannot_be_released_by_request() -> None:
    robot = GatedRobot(hardware_stop_timeout=1.0)
    robot.gate.publish("hardware_stop", Bool(data=True))
    with pytest.raises(CairnError, match="release the button first"):
        robot.gate.request("release_stop")
    robot.gate.publish("hardware_stop", Bool(data=False))
    robot.gate.request("release_stop")
    robot.gate.publish("hardware_stop", Bool(data=False))
    robot.step(("navigator_cmd_vel", AHEAD), seconds=0.5)
    assert not robot.status.emergency_stop
    assert robot.command[0] > 0.0
    robot.step(("navigator_cmd_vel", AHEAD), seconds=1.0)
    assert robot.status.emergency_stop
    assert "silent" in robot.status.reason


def test_robot_stands_until_the_button_reports_without_latching_the_stop() -> None:
    robot = GatedRobot(hardware_stop_timeout=0.5)
    robot.step(("navigator_cmd_vel", AHEAD), seconds=3.0)
    assert robot.command == (0.0, 0.0)
    assert "hardware_stop is silent" in robot.status.reason
    robot.step(("hardware_stop", Bool(data=False)), ("navigator_cmd_vel", AHEAD), seconds=1.0)
    assert robot.command == (0.4, 0.0)


def test_commands_that_the_base_cannot_execute_are_refused() -> None:
    robot = GatedRobot()
    sideways = Twist(linear=Vector3(x=0.2, y=0.1))
    robot.step(("navigator_cmd_vel", sideways), ("external_cmd_vel", AHEAD), seconds=0.6)
    assert robot.command == (0.0, 0.0)
    assert robot.status.refused_invalid > 0
    assert robot.status.refused_disabled > 0
    robot.step(("navigator_cmd_vel", Twist(linear=Vector3(x=5.0))), seconds=1.5)
    assert robot.command[0] == pytest.approx(0.6)
    assert robot.status.clamped > 0


def test_obstacle_put_before_the_robot_stops_it_within_a_scan_period() -> None:
    robot = GatedRobot()
    robot.step(("navigator_cmd_vel", Twist(linear=Vector3(x=0.6))), seconds=1.5)
    robot.points = np.array([[robot.pose[0] + 0.35, 0.0]])
    robot.step(("navigator_cmd_vel", Twist(linear=Vector3(x=0.6))), seconds=0.12)
    assert robot.command[0] < 0.35  # with room to stop in 0.13 m
    robot.step(("navigator_cmd_vel", AHEAD), seconds=1.0)
    assert robot.gap > 0.0
    assert robot.status.reason_code == ReasonCode.OBSTACLE
    robot.step(("navigator_cmd_vel", Twist(linear=Vector3(x=-0.1))), seconds=1.0)
    assert robot.command[0] < 0.0  # back over ground that was seen


def test_autonomous_sources_do_not_reverse_onto_unseen_ground() -> None:
    robot = GatedRobot()
    back = Twist(linear=Vector3(x=-0.2))
    robot.step(("navigator_cmd_vel", back), seconds=1.0)
    assert robot.command == (0.0, 0.0)
    lease = robot.gate.request("acquire_lease", operator="anna", seconds=5.0)["lease"]
    for _ in range(30):
        robot.step(("teleoperation", robot.teleoperate(lease, -0.3)))
    assert robot.command[0] == pytest.approx(-0.1, abs=0.02)


# Without the check of obstacles, the commands of each of these seeds touch one.
@pytest.mark.parametrize("seed", sampled([1, 3, 5, 6, 7]))
def test_random_commands_among_random_obstacles_touch_nothing(seed: int) -> None:
    random = np.random.default_rng(seed)
    robot = GatedRobot()
    points = random.uniform(-2.5, 2.5, (25, 2))
    robot.points = points[np.hypot(points[:, 0], points[:, 1]) > 0.4]
    for _ in range(25):
        speed, turn = random.uniform(-0.6, 0.9), random.uniform(-2, 2)
        command = Twist(linear=Vector3(x=float(speed)), angular=Vector3(z=float(turn)))
        robot.step(("navigator_cmd_vel", command), seconds=float(random.uniform(0.04, 0.8)))
    assert robot.gap > -0.002
