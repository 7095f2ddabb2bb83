"""The contract of odometry alone, as a recorded base keeps it, too: `odom`, nav_msgs/Odometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest

from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.tf2_msgs import TFMessage
from cairn.testing import odometry as judged
from cairn.testing import stamps as timed
from cairn.testing.bench import Bench
from cairn.testing.driver_contract import Contract
from cairn.testing.pauses import undisturbed
from cairn.testing.reading import Arrival

Odoms = Sequence[Arrival[Odometry]]


@dataclass(frozen=True)
class Drive:
    """A drive: odometry while it stood, went ahead, stood again, turned left, and was left alone.

    `transforms` are all that came on tf, None where the driver has no such port.
    """

    before: Odoms
    ahead: Odoms
    left: Odoms
    after: Odoms
    transforms: Sequence[TFMessage] | None

    @property
    def all(self) -> list[Odometry]:
        """The whole drive."""
        parts = (self.before, self.ahead, self.left, self.after)
        return [arrival.message for part in parts for arrival in part]


class OdometryContract(Contract):
    """What odometry says, and when."""

    component: ClassVar[str] = "base"
    port: ClassVar[str] = "odom"
    message: ClassVar[type[Any]] = Odometry

    rate_tolerance: ClassVar[float] = 0.1
    """How far the rate may be off the nominal one, as a share."""

    jitter: ClassVar[float] = 0.5
    """How far a spacing of stamps may be off the median, as a share."""

    oldest_s: ClassVar[float] = 0.25
    """How old odometry may be when it comes [s]."""

    early_s: ClassVar[float] = 0.005
    """By how much a stamp may be in the future [s]."""

    odom_frame: ClassVar[str] = "odom"
    """The frame of poses."""

    base_frame: ClassVar[str] = "base_link"
    """The frame of the robot, and of twists."""

    accuracy: ClassVar[float] = 0.2
    """How far a speed may be off the command, and a twist off the change of pose, as a share."""

    sample_count: ClassVar[int] = 20
    """How many messages are judged of a base that is not driven."""

    @pytest.fixture(scope="class")
    @classmethod
    def drive(cls, bench: Bench) -> Drive:
        """Odometry in a row, that the tests of the class share: nobody drives."""
        robot = bench.robot(cls.component)
        tf = cls.port_of(robot, "tf")
        transforms = None if tf is None else robot.read(tf.topic, TFMessage)
        with robot.read(cls.topic(robot, cls.port), Odometry) as odom:
            before = undisturbed(lambda: cls.sample(odom, cls.sample_count, after=odom.count))
        if transforms is None:
            return Drive(before, (), (), (), None)
        with transforms:
            return Drive(before, (), (), (), transforms.messages)

    def test_rate(self, drive: Drive) -> None:
        """It is the nominal one: who plans by it relies on it."""
        timed.check_rate(timed.stamps_of(drive.before), self.rate_hz, self.rate_tolerance)

    def test_stamps_increase_regularly(self, drive: Drive) -> None:
        """Speeds are divided by their differences."""
        stamps = timed.stamps_of(drive.before)
        timed.check_increasing(stamps)
        timed.check_regular(stamps, self.jitter)

    def test_stamps_are_of_the_present(self, drive: Drive) -> None:
        """Neither of the future nor of long ago, by the deployment's clock."""
        timed.check_present(drive.before, -self.early_s, self.oldest_s, self.early_s)

    def test_frames(self, drive: Drive) -> None:
        """As REP 105 names them."""
        judged.check_frames(drive.all[0], self.odom_frame, self.base_frame)

    def test_pose_is_on_the_plane(self, drive: Drive) -> None:
        """A rotation about z, and no height."""
        for odom in drive.all:
            judged.check_pose(odom)

    def test_covariance(self, drive: Drive) -> None:
        """One that filters can use."""
        for odom in drive.all:
            judged.check_covariance(odom)

    def test_twist_agrees_with_pose(self, drive: Drive) -> None:
        """The one is the change of the other."""
        judged.check_twist_agrees(drive.all, self.accuracy)

    def test_tf_agrees_with_odometry(self, drive: Drive) -> None:
        """Who reads the one and who reads the other see the same robot."""
        if drive.transforms is None:
            pytest.skip(f"{self.component} has no port tf")
        judged.check_transforms_agree(drive.all, drive.transforms, self.odom_frame, self.base_frame)
