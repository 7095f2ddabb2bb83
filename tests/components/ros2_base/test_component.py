"""The driver of a base that speaks ROS 2, on virtual time: what it sends on, and when not."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cairn import SECOND, from_ns, to_ns
from cairn.components.ros2_base.component import Ros2Base
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

AHEAD = Twist(linear=Vector3(x=0.3), angular=Vector3(z=0.2))
REST = Twist()


class Base(ComponentHarness[Ros2Base]):
    """The driver, and a base that tells odometry 20 times a second while it is `well`."""

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
            twist=TwistWithCovariance(twist=AHEAD),
        )

    def run(self, seconds: float, command: Twist | None = None, *, well: bool = True) -> None:
        """Let time pass, with odometry, and a command ten times a second."""
        for step in range(round(seconds * 20)):
            if well:
                self.publish("base_odom", self.odometry(self.x))
            if command is not None and step % 2 == 0:
                self.publish("cmd_vel", command)
            self.run_for(0.05)

    def go_to(self, x: float) -> None:
        """Be commanded ahead, and go so far."""
        while self.x < x:
            self.x = min(x, self.x + 0.03)
            self.run(0.05, AHEAD)

    def levels(self) -> list[int]:
        return [one.status[0].level for one in self.take("diagnostics")]

    def diagnosis(self) -> str:
        """What it told of itself last."""
        message: str = self.take("diagnostics")[-1].status[0].message
        return message


def started(**parameters: Any) -> Base:
    """One whose base works, and which has been silent for a while."""
    base = Base(**parameters)
    base.run_for(10.0)  # the virtual clock begins at 0, where ages would be beyond it
    base.run(2.0)
    for port in ("base_cmd_vel", "base_cmd_vel_stamped", "odom", "tf", "diagnostics"):
        base.take(port)
    return base


def test_a_command_is_sent_on_at_once_and_said_again() -> None:
    base = started()

    base.publish("cmd_vel", AHEAD)
    assert base.take("base_cmd_vel") == [AHEAD]

    base.run_for(0.26)
    assert base.take("base_cmd_vel") == 5 * [AHEAD]
    assert base.take("base_cmd_vel_stamped") == []


def test_stale_it_becomes_rest_and_then_silence() -> None:
    base = started()
    base.run(1.0, AHEAD)
    base.take("base_cmd_vel")

    base.run(1.0)
    sent = base.take("base_cmd_vel")
    assert sent[-1] == REST
    assert sent.count(REST) >= 10
    assert set(map(repr, sent)) <= {repr(AHEAD), repr(REST)}

    base.run(1.0)
    base.take("base_cmd_vel")
    base.run(2.0)
    assert base.take("base_cmd_vel") == []  # a joystick may have the base


def test_at_first_it_tells_the_base_to_rest() -> None:
    base = Base()
    base.run_for(0.5)

    assert set(map(repr, base.take("base_cmd_vel"))) == {repr(REST)}


def test_failing_it_tells_the_base_to_rest() -> None:
    base = started()
    base.publish("cmd_vel", AHEAD)
    base.take("base_cmd_vel")

    def fail(message: Odometry) -> None:
        raise ArithmeticError(message.child_frame_id)

    base.runtime.run("tell", fail, base.odometry(0.0))

    assert base.take("base_cmd_vel") == [REST]


def test_deactivated_it_tells_the_base_to_rest() -> None:
    base = started()
    base.publish("cmd_vel", AHEAD)
    base.take("base_cmd_vel")

    base.runtime.transition(Transition.DEACTIVATE)

    assert base.take("base_cmd_vel") == [REST]


def test_without_odometry_the_base_is_not_driven() -> None:
    base = started()
    base.run(1.0, AHEAD)
    assert base.take("base_cmd_vel")[-1] == AHEAD

    base.run(1.0, AHEAD, well=False)
    assert base.take("base_cmd_vel")[-1] == REST
    base.run(1.1, AHEAD, well=False)
    assert set(map(repr, base.take("base_cmd_vel"))) == {repr(REST)}
    assert base.levels()[-1] == 2

    base.run(1.1, AHEAD)
    assert base.take("base_cmd_vel")[-1] == AHEAD
    assert base.levels()[-1] == 0


def test_a_command_beyond_the_limits_keeps_its_curve() -> None:
    base = started(speed=0.5, turn=1.0)

    base.publish("cmd_vel", Twist(linear=Vector3(x=-5.0), angular=Vector3(z=2.0)))

    (sent,) = base.take("base_cmd_vel")
    assert sent.linear.x == pytest.approx(-0.5)
    assert sent.angular.z == pytest.approx(0.2)


def test_a_controller_since_jazzy_is_sent_stamped_commands() -> None:
    base = started(stamped=True)

    base.publish("cmd_vel", AHEAD)

    (sent,) = base.take("base_cmd_vel_stamped")
    assert isinstance(sent, TwistStamped)
    assert sent.twist == AHEAD
    assert (to_ns(sent.header.stamp), sent.header.frame_id) == (base.now_ns, "base_link")
    assert base.take("base_cmd_vel") == []


def test_a_base_without_a_clock_is_sent_commands_of_its_own_present() -> None:
    base = started(stamped=True, stamp_on_arrival=True)

    base.publish("cmd_vel", AHEAD)

    (sent,) = base.take("base_cmd_vel_stamped")
    assert sent.twist == AHEAD
    assert to_ns(sent.header.stamp) == 0  # its controller puts its own time there


def test_odometry_is_sent_on_as_it_is_with_its_transform() -> None:
    base = started(odom_frame="bot/odom", base_frame="bot/base_footprint")
    given = base.odometry(1.5, frame="bot/odom", child="bot/base_footprint")

    base.publish("base_odom", given)

    (odom,) = base.take("odom")
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert odom.header.stamp == given.header.stamp
    assert planar_pose(odom.pose.pose) == pytest.approx((1.5, 0.0, 0.1))
    assert odom.twist == given.twist
    (tf,) = base.take("tf")
    assert tf.transforms[0].transform.translation.x == 1.5
    assert tf.transforms[0].child_frame_id == "base_link"


def test_a_base_that_sends_its_own_transform_is_left_to_it() -> None:
    base = started(send_tf=False)
    base.run(0.5)

    assert base.take("odom")
    assert base.take("tf") == []


def test_where_odometry_jumps_it_is_led_on() -> None:
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


def test_a_base_that_comes_back_at_its_origin_was_started_anew() -> None:
    base = started()
    base.go_to(0.6)
    base.run(3.0, AHEAD, well=False)  # it starts; nobody has noticed, and commands go on
    base.x = 0.0
    base.take("odom")
    base.take("base_cmd_vel")

    base.run(1.2, AHEAD)

    xs = [planar_pose(odom.pose.pose)[0] for odom in base.take("odom")]
    assert xs == pytest.approx(len(xs) * [0.6]), "the robot is where it was"
    assert set(map(repr, base.take("base_cmd_vel"))) == {repr(REST)}, "it sets off by itself"
    assert "once the command has been rest" in base.diagnosis()

    base.run(0.1, REST)
    base.run(1.2, AHEAD)
    assert base.take("base_cmd_vel")[-1] == AHEAD
    assert base.diagnosis() == "drives"


def test_a_base_that_was_out_of_reach_goes_on_where_it_is() -> None:
    base = started()
    base.go_to(0.6)
    base.run_for(3.0)
    base.x = 1.6  # somebody drove it meanwhile
    base.take("odom")

    base.run(0.2, AHEAD)

    assert planar_pose(base.take("odom")[-1].pose.pose)[0] == pytest.approx(1.6)
    assert base.take("base_cmd_vel")[-1] == AHEAD


def test_led_on_with_another_heading_the_covariance_is_turned_with_the_pose() -> None:
    base = started()
    base.publish("base_odom", base.odometry(2.0, heading=0.1 + math.pi / 2))
    base.run_for(0.05)
    covariance = np.diag([4.0, 1.0, 0.0, 0.0, 0.0, 9.0])
    given = base.odometry(2.0, heading=0.1 + math.pi / 2)
    base.take("odom")

    base.publish("base_odom", _with_covariance(given, covariance))

    (odom,) = base.take("odom")
    turned = odom.pose.covariance.reshape(6, 6)
    assert np.diag(turned) == pytest.approx([1.0, 4.0, 0.0, 0.0, 0.0, 9.0])
    assert turned == pytest.approx(turned.T)


def _with_covariance(odom: Odometry, covariance: np.ndarray) -> Odometry:
    pose = PoseWithCovariance(pose=odom.pose.pose, covariance=covariance.ravel())
    return replace(odom, pose=pose)


def test_odometry_of_a_base_that_tilts_is_brought_to_the_plane() -> None:
    base = started()
    given = base.odometry(0.0)
    tilted = Quaternion(x=0.1, y=0.0, z=0.2, w=0.97)  # of length 0.995
    pose = PoseWithCovariance(pose=Pose(position=Point(z=0.05), orientation=tilted))

    base.publish("base_odom", replace(given, pose=pose))

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
def test_odometry_that_cannot_be_relied_on_is_not_sent_on(message: Any) -> None:
    base = started()

    base.publish("base_odom", message(base))

    assert base.take("odom") == []
    base.run_for(1.1)
    assert base.take("diagnostics")[-1].status[0].values[2].value == "1"


def test_why_odometry_is_refused_is_told_instead_of_silence() -> None:
    base = started(base_frame="base_footprint")
    base.run(1.0)

    assert "set base_frame and odom_frame" in base.diagnosis()


@pytest.mark.parametrize("age_s", [0.0, -0.08], ids=["in time", "with a clock that is ahead"])
def test_odometry_that_comes_twice_is_sent_on_once(age_s: float) -> None:
    base = started()
    message = base.odometry(0.0, age_s)

    base.publish("base_odom", message)
    base.publish("base_odom", message)

    assert len(base.take("odom")) == 1


def test_two_nodes_that_tell_odometry_do_not_flood_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    base = started()
    caplog.clear()
    for _ in range(40):
        base.run(0.05)
        base.publish("base_odom", base.odometry(0.0, age_s=0.07))  # the other one's, which is later

    told = [record.message for record in caplog.records if "out of order" in record.message]
    assert "does more than one node write" in told[0]
    assert len(told) <= 6, "1, 2, 4, 8, 16, 32 of them"


def test_a_base_whose_clock_is_not_set_is_stamped_on_arrival() -> None:
    base = started(stamp_on_arrival=True)

    base.publish("base_odom", base.odometry(0.0, age_s=9.0))

    (odom,) = base.take("odom")
    assert to_ns(odom.header.stamp) == base.now_ns
