"""The checks of odometry accept correct messages and reject wrong ones."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Self, cast

import pytest

from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.geometry_msgs import (
    Pose,
    PoseWithCovariance,
    Quaternion,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.system.clock import SECOND
from cairn.testing.base_contract import DriveContract
from cairn.testing.odometry_contract import (
    OdometryContract,
    check_covariance,
    check_twist_agrees,
    traveled,
)
from cairn.testing.robot import RunningDeployment

TURN_RATE = 0.5


def turned(seconds: float, start: float) -> Odometry:
    """Return odometry of a base that has turned on the spot for that time from a heading [rad]."""
    heading = math.remainder(start + TURN_RATE * seconds, 2.0 * math.pi)
    rotation = Quaternion(z=math.sin(0.5 * heading), w=math.cos(0.5 * heading))
    return Odometry(
        header=Header(stamp=from_ns(round(seconds * SECOND)), frame_id="odom"),
        child_frame_id="base_link",
        pose=PoseWithCovariance(pose=Pose(orientation=rotation)),
        twist=TwistWithCovariance(twist=Twist(angular=Vector3(z=TURN_RATE))),
    )


def test_turn_through_180_degrees_agrees_with_its_twists() -> None:
    odoms = [turned(0.1 * step, start=2.7) for step in range(21)]

    check_twist_agrees(odoms, tolerance=0.05)

    assert traveled(odoms).left_rad == pytest.approx(1.0)


class SilentReading:
    """A reading on whose topic nothing arrives."""

    count = 0

    def __init__(self) -> None:
        self.is_open = True

    def await_count(self, *_: object, **__: object) -> None:
        raise AssertionError("received 0")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.is_open = False


class SilentBase:
    """A deployment whose base has all ports, but publishes nothing."""

    name = "robot"

    def __init__(self) -> None:
        self.readings: dict[str, SilentReading] = {}

    def status(self, _: str) -> SimpleNamespace:
        ports = {"odom": PortStatus.OUT, "tf": PortStatus.OUT, "cmd_vel": PortStatus.IN}
        return SimpleNamespace(
            ports=[PortStatus(port, f"/robot/{port}", way) for port, way in ports.items()]
        )

    def writers(self, _: str) -> set[str]:
        return set()

    def read(self, topic: str, *_: object) -> SilentReading:
        self.readings[topic] = SilentReading()
        return self.readings[topic]


class Sampled(OdometryContract):
    rate_hz = 50.0


class Driven(DriveContract):
    rate_hz = 50.0


@pytest.mark.parametrize("contract", [Sampled, Driven])
def test_sample_that_fails_leaves_no_reading_open(contract: type[OdometryContract]) -> None:
    base = SilentBase()

    with pytest.raises(AssertionError, match="received 0"):
        contract.record_drive(cast("RunningDeployment", base))

    assert {topic: one.is_open for topic, one in base.readings.items()} == {
        "/robot/odom": False,
        "/robot/tf": False,
    }


@pytest.mark.parametrize("part", ["pose", "twist"])
@pytest.mark.parametrize("index", range(6))
def test_each_negative_variance_is_rejected(part: str, index: int) -> None:
    variances = [0.01] * 6
    variances[index] = -0.01
    covariance = tuple(
        variances[row] if row == column else 0.0 for row in range(6) for column in range(6)
    )
    odom = turned(0.0, start=0.0)
    wrong = replace(odom, **{part: replace(getattr(odom, part), covariance=covariance)})

    check_covariance(odom)
    with pytest.raises(AssertionError, match=f"the {part} has a negative variance"):
        check_covariance(wrong)
