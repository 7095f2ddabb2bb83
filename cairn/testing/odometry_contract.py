"""The contract of odometry alone, such as that of a recorded base: `odom`, nav_msgs/Odometry.

A failed check raises `AssertionError`, which describes the fault. Units are meters, radians and
seconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import pytest

from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.geometry_msgs import Quaternion
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.tf2_msgs import TFMessage
from cairn.testing import timing as timed
from cairn.testing.driver_contract import StampedContract
from cairn.testing.robot import Arrival, Bench, Reading, RunningDeployment
from cairn.testing.timing import undisturbed

Odoms = Sequence[Arrival[Odometry]]
_UNIT = 1e-3  # tolerance of a quaternion's length
_DISTANCE_M = 0.02  # tolerance of distances of any length: encoders have steps
_TURN_RAD = 0.05


@dataclass(frozen=True)
class Drive:
    """The odometry of a drive by phase: standing, driving ahead, turning left, after the commands.

    `transforms` holds all messages on tf; None if the driver has no such port.
    """

    before: Odoms
    ahead: Odoms
    left: Odoms
    after: Odoms
    transforms: Sequence[TFMessage] | None

    @property
    def all(self) -> list[Odometry]:
        """Odometry of all phases."""
        parts = (self.before, self.ahead, self.left, self.after)
        return [arrival.message for part in parts for arrival in part]


class OdometryContract(StampedContract):
    """Tests the contents and stamps of odometry."""

    component: ClassVar[str] = "base"
    port: ClassVar[str] = "odom"
    message: ClassVar[type[Any]] = Odometry

    jitter: ClassVar[float] = 0.5
    oldest_s: ClassVar[float] = 0.25

    odom_frame: ClassVar[str] = "odom"
    """Expected frame of the poses (`frame_id`)."""

    base_frame: ClassVar[str] = "base_link"
    """Expected frame of the robot and its twists (`child_frame_id`)."""

    accuracy: ClassVar[float] = 0.2
    """Allowed relative error of a speed from its command, and of twists from changes of pose."""

    sample_count: ClassVar[int] = 20
    """Number of messages in a sample of a base that is not driven."""

    @pytest.fixture(scope="class")
    @classmethod
    def drive(cls, bench: Bench) -> Drive:
        """Return the odometry of a drive, which the tests of the class share."""
        robot = bench.robot(cls.component)
        return undisturbed(lambda: cls.record_drive(robot))

    @classmethod
    def record_drive(cls, robot: RunningDeployment) -> Drive:
        """Return a sample of odometry without commands."""
        with cls.transforms_of(robot) as transforms:
            with robot.read(cls.topic(robot, cls.port), Odometry) as odom:
                before = cls.sample(odom, cls.sample_count, after=odom.count)
            messages = None if transforms is None else transforms.messages
            return Drive(before, (), (), (), messages)

    @classmethod
    @contextmanager
    def transforms_of(cls, robot: RunningDeployment) -> Iterator[Reading[TFMessage] | None]:
        """Collect the messages on tf within the context; None if the driver has no such port."""
        tf = cls.port_of(robot, "tf")
        if tf is None:
            yield None
        else:
            with robot.read(tf.topic, TFMessage) as transforms:
                yield transforms

    def test_rate_is_nominal(self, drive: Drive) -> None:
        """Odometry arrives at the nominal rate, on which subscribers rely."""
        timed.check_rate(timed.stamps_of(drive.before), self.rate_hz, self.rate_tolerance)

    def test_stamps_increase_regularly(self, drive: Drive) -> None:
        """Stamps increase regularly: subscribers divide by their differences."""
        stamps = timed.stamps_of(drive.before)
        timed.check_increasing(stamps)
        timed.check_regular(stamps, self.jitter)

    def test_stamps_are_current(self, drive: Drive) -> None:
        """On arrival, stamps are neither too old nor in the future by the deployment's clock."""
        timed.check_present(drive.before, -self.early_s, self.oldest_s, self.early_s)

    def test_frame_ids_are_as_configured(self, drive: Drive) -> None:
        """Frames are named as in REP 105."""
        check_frames(drive.all[0], self.odom_frame, self.base_frame)

    def test_pose_is_on_the_plane(self, drive: Drive) -> None:
        """The pose has no height and is rotated about z only."""
        for odom in drive.all:
            check_pose(odom)

    def test_covariance_is_valid(self, drive: Drive) -> None:
        """Covariances are symmetric, and variances are not negative, as filters require."""
        for odom in drive.all:
            check_covariance(odom)

    def test_twist_agrees_with_pose(self, drive: Drive) -> None:
        """The integral of the twists is the change of the pose."""
        check_twist_agrees(drive.all, self.accuracy)

    def test_tf_agrees_with_odometry(self, drive: Drive) -> None:
        """At equal stamps, tf and odometry have the same pose."""
        if drive.transforms is None:
            pytest.skip(f"{self.component} has no port tf")
        check_transforms_agree(drive.all, drive.transforms, self.odom_frame, self.base_frame)


@dataclass(frozen=True)
class Traveled:
    """The motion of a base: summed from its poses, and integrated from its twists."""

    ahead_m: float
    ahead_by_twist_m: float
    left_rad: float
    left_by_twist_rad: float
    longest_speed: float
    """The highest speed of a twist [m/s]."""


def traveled(odoms: Sequence[Odometry]) -> Traveled:
    """Sum up the distance ahead (along the heading, backward negative) and the turn to the left."""
    ahead = left = ahead_by_twist = left_by_twist = 0.0
    for before, after in pairwise(odoms):
        seconds = (to_ns(after.header.stamp) - to_ns(before.header.stamp)) / 1e9
        turn = _wrapped(_heading(after) - _heading(before))
        middle = _heading(before) + 0.5 * turn
        step = [
            after.pose.pose.position.x - before.pose.pose.position.x,
            after.pose.pose.position.y - before.pose.pose.position.y,
        ]
        ahead += step[0] * math.cos(middle) + step[1] * math.sin(middle)
        left += turn
        twist = after.twist.twist
        ahead_by_twist += seconds * twist.linear.x
        left_by_twist += seconds * twist.angular.z
    fastest = max((abs(odom.twist.twist.linear.x) for odom in odoms), default=0.0)
    return Traveled(ahead, ahead_by_twist, left, left_by_twist, fastest)


def check_frames(odom: Odometry, frame: str, child: str) -> None:
    """Check that the pose is in frame `frame`, and the twist in frame `child`."""
    found = (odom.header.frame_id, odom.child_frame_id)
    assert found == (frame, child), (
        f"odometry has child_frame_id {found[1]!r} and frame_id {found[0]!r}, but should have "
        f"{child!r} and {frame!r}"
    )


def check_pose(odom: Odometry) -> None:
    """Check that the orientation is a unit quaternion about z, and that z is 0."""
    rotation = odom.pose.pose.orientation
    length = math.hypot(rotation.x, rotation.y, rotation.z, rotation.w)
    assert abs(length - 1.0) <= _UNIT, (
        f"the orientation's quaternion has length {length:g}, not 1: it is not a rotation"
    )
    tilt = math.hypot(rotation.x, rotation.y)
    assert tilt <= _UNIT, (
        f"the orientation {rotation} is tilted, but a base on the plane turns about z only; is the "
        "order x, y, z, w?"
    )
    z = odom.pose.pose.position.z
    assert abs(z) <= 1e-6, f"the base is at z = {z:g} m, but odometry is on the plane; set z to 0"


def check_covariance(odom: Odometry) -> None:
    """Check that covariances are symmetric and variances are not negative."""
    for name, values in (("pose", odom.pose.covariance), ("twist", odom.twist.covariance)):
        matrix = np.asarray(values).reshape(6, 6)
        assert np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12), (
            f"the covariance of the {name} is not symmetric: {matrix.tolist()}"
        )
        assert (matrix.diagonal() >= 0.0).all(), (
            f"the covariance of the {name} has a negative variance: {matrix.diagonal().tolist()}"
        )


def check_twist_agrees(odoms: Sequence[Odometry], tolerance: float) -> None:
    """Check that the integrated twists agree with the poses, within a relative tolerance."""
    total = traveled(odoms)
    _agree(
        total.ahead_m,
        total.ahead_by_twist_m,
        tolerance,
        _DISTANCE_M,
        "m ahead",
        "m/s (and in base_link)",
    )
    _agree(
        total.left_rad, total.left_by_twist_rad, tolerance, _TURN_RAD, "rad to the left", "rad/s"
    )


def check_transforms_agree(
    odoms: Sequence[Odometry], transforms: Sequence[TFMessage], frame: str, child: str
) -> None:
    """Check that tf equals odometry at every common stamp."""
    poses = {to_ns(odom.header.stamp): odom.pose.pose for odom in odoms}
    compared = 0
    for message in transforms:
        for there in message.transforms:
            pose = poses.get(to_ns(there.header.stamp))
            if (there.header.frame_id, there.child_frame_id) != (frame, child) or pose is None:
                continue
            compared += 1
            move, turn = there.transform.translation, there.transform.rotation
            off_m = math.dist((move.x, move.y), (pose.position.x, pose.position.y))
            off_rad = abs(_wrapped(_yaw(turn) - _yaw(pose.orientation)))
            assert off_m <= 1e-6, f"tf is {off_m:g} m off the position of odometry"
            assert off_rad <= 1e-6, f"tf is {off_rad:g} rad off the heading of odometry"
    assert compared, (
        f"none of {len(transforms)} messages on tf has the transform from {frame} to {child} at a "
        "stamp of odometry"
    )


def is_still(odom: Odometry, speed: float, turn: float) -> bool:
    """Return whether the twist is at most `speed` [m/s] and `turn` [rad/s]."""
    twist = odom.twist.twist
    return abs(twist.linear.x) <= speed and abs(twist.angular.z) <= turn


def _agree(pose: float, twist: float, tolerance: float, least: float, what: str, unit: str) -> None:
    assert abs(pose - twist) <= max(least, tolerance * abs(pose)), (
        f"by its poses the base moved {pose:.3f} {what}, by its twists {twist:.3f}; a twist must "
        f"be in {unit}"
    )


def _heading(odom: Odometry) -> float:
    return _yaw(odom.pose.pose.orientation)


def _yaw(rotation: Quaternion) -> float:
    return 2.0 * math.atan2(rotation.z, rotation.w)


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
