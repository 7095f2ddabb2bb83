"""The driver of a base behind ROS 2 in virtual time: which commands and odometry it passes on."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cairn import SECOND, from_ns, to_ns
from cairn.components.ros2_devices.base import Ros2Base
from cairn.planar.messages import planar_pose, pose_message
from cairn.runtime.lifecycle import Transition
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Twist,
    TwistStamped,
    TwistWithCovariance,
    Vector3,
)
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from cairn.testing.odometry_contract import check_pose

FORWARD = Twist(linear=Vector3(x=0.3), angular=Vector3(z=0.2))
REST = Twist()


class Base(ComponentHarness[Ros2Base]):
    """The driver, and a base that publishes odometry 20 times per second while it is `working`."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__(Ros2Base, parameters)
        self.x = 0.0

    def odometry(
        self,
        x: float,
        age_s: float = 0.0,
        frame: str = "odom",
        child: str = "base_link",
        heading: float = 0.1,
    ) -> Odometry:
        stamp = from_ns(self.now_ns - round(age_s * SECOND))
        return Odometry(
            header=Header(stamp=stamp, frame_id=frame),
            child_frame_id=child,
            pose=PoseWithCovariance(pose=pose_message((x, 0.0, heading))),
            twist=TwistWithCovariance(twist=FORWARD),
        )

    def run(self, seconds: float, command: Twist | None = None, *, working: bool = True) -> None:
        """Let time pass, with odometry, and a command ten times per second."""
        for step in range(round(seconds * 20)):
            if working:
                self.publish("base_odom", self.odometry(self.x))
            if command is not None and step % 2 == 0:
                self.publish("cmd_vel", command)
            self.run_for(0.05)

    def go_to(self, x: float) -> None:
        """Command forward motion until a position [m] is reached."""
        while self.x < x:
            self.x = min(x, self.x + 0.03)
            self.run(0.05, FORWARD)

    def levels(self) -> list[int]:
        return [message.status[0].level for message in self.take("diagnostics")]

    def health(self) -> str:
        """Return the newest message in its diagnostics."""
        message: str = self.take("diagnostics")[-1].status[0].message
        return message


def started(**parameters: Any) -> Base:
    """Return a driver whose base works, with no command for a while."""
    base = Base(**parameters)
    base.run_for(10.0)  # virtual time starts at 0, before which odometry cannot be stamped
    base.run(2.0)
    for port in ("base_cmd_vel", "base_cmd_vel_stamped", "odom", "tf", "diagnostics"):
        base.take(port)
    return base


def test_command_is_forwarded_at_once_and_repeated() -> None:
    base = started()

    base.publish("cmd_vel", FORWARD)
    assert base.take("base_cmd_vel") == [FORWARD]

    base.run_for(0.26)
    assert base.take("base_cmd_vel") == 5 * [FORWARD]
    assert base.take("base_cmd_vel_stamped") == []


def test_stale_command_is_followed_by_zero_velocity_and_then_nothing() -> None:
    base = started()
    base.run(1.0, FORWARD)
    base.take("base_cmd_vel")

    base.run(1.0)
    sent = base.take("base_cmd_vel")
    assert sent[-1] == REST
    assert sent.count(REST) >= 10
    assert set(map(repr, sent)) <= {repr(FORWARD), repr(REST)}

    base.run(1.0)
    base.take("base_cmd_vel")
    base.run(2.0)
    assert base.take("base_cmd_vel") == []  # a joystick may have the base


def test_activation_sends_zero_velocity() -> None:
    base = Base()
    base.run_for(0.5)

    assert set(map(repr, base.take("base_cmd_vel"))) == {repr(REST)}


def test_failure_sends_zero_velocity() -> None:
    base = started()
    base.publish("cmd_vel", FORWARD)
    base.take("base_cmd_vel")

    def fail(message: Odometry) -> None:
        raise ArithmeticError(message.child_frame_id)

    base.runtime.run("on_base_odom", fail, base.odometry(0.0))

    assert base.take("base_cmd_vel") == [REST]


def test_deactivation_sends_zero_velocity() -> None:
    base = started()
    base.publish("cmd_vel", FORWARD)
    base.take("base_cmd_vel")

    base.runtime.transition(Transition.DEACTIVATE)

    assert base.take("base_cmd_vel") == [REST]


def test_base_without_odometry_is_not_driven() -> None:
    base = started()
    base.run(1.0, FORWARD)
    assert base.take("base_cmd_vel")[-1] == FORWARD

    base.run(1.0, FORWARD, working=False)
    assert base.take("base_cmd_vel")[-1] == REST
    base.run(1.1, FORWARD, working=False)
    assert set(map(repr, base.take("base_cmd_vel"))) == {repr(REST)}
    assert base.levels()[-1] == 2

    base.run(1.1, FORWARD)
    assert base.take("base_cmd_vel")[-1] == FORWARD
    assert base.levels()[-1] == 0


def test_command_beyond_the_limits_is_slowed_down_on_the_same_curve() -> None:
    base = started(speed=0.5, turn=1.0)

    base.publish("cmd_vel", Twist(linear=Vector3(x=-5.0), angular=Vector3(z=2.0)))

    (sent,) = base.take("base_cmd_vel")
    assert sent.linear.x == pytest.approx(-0.5)
    assert sent.angular.z == pytest.approx(0.2)


def test_stamped_commands_are_sent_if_configured() -> None:
    base = started(stamped=True)

    base.publish("cmd_vel", FORWARD)

    (sent,) = base.take("base_cmd_vel_stamped")
    assert isinstance(sent, TwistStamped)
    assert sent.twist == FORWARD
    assert (to_ns(sent.header.stamp), sent.header.frame_id) == (base.now_ns, "base_link")
    assert base.take("base_cmd_vel") == []


def test_command_to_a_base_without_a_clock_has_stamp_zero() -> None:
    base = started(stamped=True, stamp_on_arrival=True)

    base.publish("cmd_vel", FORWARD)

    (sent,) = base.take("base_cmd_vel_stamped")
    assert sent.twist == FORWARD
    assert to_ns(sent.header.stamp) == 0  # its controller replaces 0 by its own time


def test_odometry_is_published_unchanged_with_its_transform() -> None:
    base = started(odom_frame="bot/odom", base_frame="bot/base_footprint")
    reported = base.odometry(1.5, frame="bot/odom", child="bot/base_footprint")

    base.publish("base_odom", reported)

    (odom,) = base.take("odom")
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert odom.header.stamp == reported.header.stamp
    assert planar_pose(odom.pose.pose) == pytest.approx((1.5, 0.0, 0.1))
    assert odom.twist == reported.twist
    (tf,) = base.take("tf")
    assert tf.transforms[0].transform.translation.x == 1.5
    assert tf.transforms[0].child_frame_id == "base_link"


def test_transform_is_not_published_if_send_tf_is_off() -> None:
    base = started(send_tf=False)
    base.run(0.5)

    assert base.take("odom")
    assert base.take("tf") == []


def test_odometry_continues_across_a_jump() -> None:
    base = started()
    base.x = 3.0
    base.run(0.2)  # from 0 to 3 m at once: the first jump
    base.x = 0.0
    base.run(0.2)
    base.x = 0.02
    base.run(0.2)

    xs = [planar_pose(odom.pose.pose)[0] for odom in base.take("odom")]
    assert max(xs) - min(xs) < 0.05
    assert xs[-1] - xs[0] == pytest.approx(0.02 * math.cos(0.0), abs=0.001)


def test_base_back_at_its_origin_counts_as_restarted() -> None:
    base = started()
    base.go_to(0.6)
    base.run(3.0, FORWARD, working=False)  # it restarts unnoticed, and commands continue
    base.x = 0.0
    base.take("odom")
    base.take("base_cmd_vel")

    base.run(1.2, FORWARD)

    xs = [planar_pose(odom.pose.pose)[0] for odom in base.take("odom")]
    assert xs == pytest.approx(len(xs) * [0.6]), "the robot is where it was"
    assert set(map(repr, base.take("base_cmd_vel"))) == {repr(REST)}, "it moves by itself"
    assert "once the command has been rest" in base.health()

    base.run(0.1, REST)
    base.run(1.2, FORWARD)
    assert base.take("base_cmd_vel")[-1] == FORWARD
    assert base.health() == "drives"


def test_base_that_was_unreachable_continues_at_its_pose() -> None:
    base = started()
    base.go_to(0.6)
    base.run_for(3.0)
    base.x = 1.6  # it was driven by hand meanwhile
    base.take("odom")

    base.run(0.2, FORWARD)

    assert planar_pose(base.take("odom")[-1].pose.pose)[0] == pytest.approx(1.6)
    assert base.take("base_cmd_vel")[-1] == FORWARD


def test_covariance_is_rotated_with_a_continued_pose() -> None:
    base = started()
    base.publish("base_odom", base.odometry(2.0, heading=0.1 + math.pi / 2))
    base.run_for(0.05)
    covariance = np.diag([4.0, 1.0, 0.0, 0.0, 0.0, 9.0])
    reported = base.odometry(2.0, heading=0.1 + math.pi / 2)
    base.take("odom")

    base.publish("base_odom", _with_covariance(reported, covariance))

    (odom,) = base.take("odom")
    turned = odom.pose.covariance.reshape(6, 6)
    assert np.diag(turned) == pytest.approx([1.0, 4.0, 0.0, 0.0, 0.0, 9.0])
    assert turned == pytest.approx(turned.T)


def _with_covariance(odom: Odometry, covariance: np.ndarray) -> Odometry:
    pose = PoseWithCovariance(pose=odom.pose.pose, covariance=covariance.ravel())
    return replace(odom, pose=pose)


def test_odometry_of_a_tilted_base_is_projected_to_the_plane() -> None:
    base = started()
    reported = base.odometry(0.0)
    tilted = Quaternion(x=0.1, y=0.0, z=0.2, w=0.97)  # of length 0.995
    pose = PoseWithCovariance(pose=Pose(position=Point(z=0.05), orientation=tilted))

    base.publish("base_odom", replace(reported, pose=pose))

    (odom,) = base.take("odom")
    check_pose(odom)


@pytest.mark.parametrize(
    "message",
    [
        lambda base: base.odometry(0.0, age_s=0.8),
        lambda base: base.odometry(0.0, age_s=-0.5),
        lambda base: base.odometry(0.0, frame="map"),
        lambda base: base.odometry(0.0, child="camera"),
        lambda base: Odometry(
            header=Header(stamp=from_ns(base.now_ns), frame_id="odom"),
            child_frame_id="base_link",
            pose=PoseWithCovariance(pose=Pose(orientation=Quaternion(w=0.0))),
        ),
    ],
    ids=["old", "of the future", "of another frame", "of another child", "without orientation"],
)
def test_unusable_odometry_is_not_published(message: Any) -> None:
    base = started()

    base.publish("base_odom", message(base))

    assert base.take("odom") == []
    base.run_for(1.1)
    assert base.take("diagnostics")[-1].status[0].values[2].value == "1"


def test_odometry_without_frames_and_of_another_length_is_used_and_reported_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    base = started()
    doubled = Quaternion(z=2.0 * math.sin(0.25), w=2.0 * math.cos(0.25))
    pose = PoseWithCovariance(pose=Pose(position=Point(x=0.1), orientation=doubled))

    for _ in range(3):
        base.publish("base_odom", replace(base.odometry(0.0, frame="", child=""), pose=pose))
        base.run_for(0.05)

    assert [planar_pose(odom.pose.pose) for odom in base.take("odom")][-3:] == [
        pytest.approx((0.1, 0.0, 0.5))
    ] * 3
    for said in ("name no frame", "name no child frame", "not of length 1"):
        assert caplog.text.count(said) == 1


def test_rejected_odometry_is_reported_with_the_reason() -> None:
    base = started(base_frame="base_footprint")
    base.run(1.0)

    assert "set base_frame and odom_frame" in base.health()


@pytest.mark.parametrize("age_s", [0.0, -0.08], ids=["in time", "with a clock that is ahead"])
def test_repeated_odometry_is_published_once(age_s: float) -> None:
    base = started()
    message = base.odometry(0.0, age_s)

    base.publish("base_odom", message)
    base.publish("base_odom", message)

    assert len(base.take("odom")) == 1


def test_odometry_that_arrives_out_of_order_is_published_with_its_own_time() -> None:
    base = started()
    base.go_to(0.6)
    base.take("odom")

    late = base.odometry(0.585, age_s=0.07)
    base.publish("base_odom", late)
    base.publish("base_odom", late)

    (odom,) = base.take("odom")
    assert odom.header.stamp == late.header.stamp
    assert planar_pose(odom.pose.pose)[0] == pytest.approx(0.585)
    assert base.take("tf")[-1].transforms[0].header.stamp == late.header.stamp
    base.run(1.2)
    assert base.take("diagnostics")[-1].status[0].values[3].value == "0", "jumps"
    assert planar_pose(base.take("odom")[-1].pose.pose)[0] == pytest.approx(0.6)


def test_late_odometry_of_the_time_before_a_jump_is_continued_as_the_odometry_of_that_time() -> (
    None
):
    base = started()
    base.x = 3.0
    base.run(0.2)
    base.x = 7.0
    base.run(0.2)  # the base jumped from 3 m to 7 m
    base.take("odom")

    base.publish("base_odom", base.odometry(3.0, age_s=0.32))
    base.publish("base_odom", base.odometry(7.0, age_s=0.12))

    xs = [planar_pose(odom.pose.pose)[0] for odom in base.take("odom")]
    assert xs == pytest.approx([0.0, 0.0])


def test_odometry_of_a_base_whose_clock_was_set_back_is_used_again() -> None:
    base = started(odom_age_s=2.0)
    for _ in range(10):
        base.publish("base_odom", base.odometry(0.0, age_s=1.0))
        base.run_for(0.05)
    assert len(base.take("odom")) == 10 - 4, "after five in a row"


def test_two_odometry_publishers_do_not_flood_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    base = started()
    caplog.clear()
    for _ in range(40):
        base.run(0.05)
        base.publish("base_odom", base.odometry(3.0, age_s=0.07))  # from the other publisher, later

    warnings = [record.message for record in caplog.records if "out of order" in record.message]
    assert "only one node publishes" in warnings[0]
    assert len(warnings) <= 6, "1, 2, 4, 8, 16, 32 of them"


def test_odometry_can_be_stamped_on_arrival() -> None:
    base = started(stamp_on_arrival=True)

    base.publish("base_odom", base.odometry(0.0, age_s=9.0))

    (odom,) = base.take("odom")
    assert to_ns(odom.header.stamp) == base.now_ns
