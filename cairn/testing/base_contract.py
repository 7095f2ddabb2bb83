"""The contract of a base: `cmd_vel` in, geometry_msgs/Twist; `odom`, nav_msgs/Odometry, and `tf`.

The tests drive the robot: a short distance ahead, a turn to the left on the spot. A real robot
needs half a meter of space, or wheels off the ground.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import ClassVar

import pytest

from cairn.clock import SECOND
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.tf2_msgs import TFMessage
from cairn.testing import odometry_contract as odometry
from cairn.testing import timing as timed
from cairn.testing.device import Wheeled
from cairn.testing.driver_contract import (
    EndContract,
    LifeCycleContract,
    ParametersContract,
    StopContract,
    UnplugContract,
)
from cairn.testing.odometry_contract import Drive, OdometryContract, Odoms
from cairn.testing.robot import Arrival, Bench, Reading, RunningDeployment
from cairn.testing.timing import undisturbed

_WHEELS_NOT_OBSERVED = (
    "the wheels cannot be observed: no fixture `device` with turns and await_stand"
)


class DriveContract(OdometryContract):
    """How commands are executed, as odometry shows it."""

    speed: ClassVar[float] = 0.2
    """How fast the tests drive ahead [m/s]."""

    turn: ClassVar[float] = 0.5
    """How fast they turn [rad/s]."""

    drive_s: ClassVar[float] = 1.2
    """How long a command is repeated; the second half of this time is judged [s]."""

    still: ClassVar[float] = 0.02
    """Speeds up to this one count as standing [m/s, rad/s]."""

    stop_limit_s: ClassVar[float] = 1.5
    """Time limit until the wheels stand after the last command [s], braking included."""

    top_speed: ClassVar[float | None] = None
    """The highest speed that the driver allows [m/s], whatever is commanded; None: not tested."""

    @pytest.fixture(scope="class")
    @classmethod
    def drive(cls, bench: Bench) -> Drive:
        """A drive that the tests of the class share."""
        robot = bench.robot(cls.component)
        return undisturbed(lambda: cls._driven(robot))

    @classmethod
    def _driven(cls, robot: RunningDeployment) -> Drive:
        tf = cls.port_of(robot, "tf")
        transforms = None if tf is None else robot.read(tf.topic, TFMessage)
        command = cls.topic(robot, "cmd_vel")
        span = max(2, math.ceil(cls.drive_s * cls.rate_hz))
        with robot.read(cls.topic(robot, cls.port), Odometry) as odom:
            cls.sample(odom, max(10, span // 2))
            started = odom.count
            with robot.publishing(command, cls.ahead()):
                cls.sample(odom, span, after=odom.count)
                turned = odom.count
            with robot.publishing(command, cls.leftwards()):
                cls.sample(odom, span, after=odom.count)
                ceased = odom.count
            end = max(2, math.ceil((cls.stop_limit_s + 0.5) * cls.rate_hz))
            cls.sample(odom, end, after=odom.count)
        arrivals = odom.arrivals
        parts = (
            arrivals[:started],
            arrivals[started:turned],
            arrivals[turned:ceased],
            arrivals[ceased:],
        )
        if transforms is None:
            return Drive(*parts, None)
        with transforms:
            return Drive(*parts, transforms.messages)

    @pytest.fixture
    def driving(self, robot: RunningDeployment, output: Reading[Odometry]) -> Reading[Odometry]:
        """Odometry of the base, which was driven to its speed and gets no more commands."""
        with robot.publishing(self.topic(robot, "cmd_vel"), self.ahead()):
            output.await_that(
                lambda arrivals: any(
                    arrival.message.twist.twist.linear.x > 0.5 * self.speed for arrival in arrivals
                ),
                f"a speed of more than {0.5 * self.speed:g} m/s by odometry",
            )
        return output

    @classmethod
    def ahead(cls) -> Twist:
        """Return the command to drive ahead."""
        return Twist(linear=Vector3(x=cls.speed))

    @classmethod
    def leftwards(cls) -> Twist:
        """Return the command to turn left on the spot."""
        return Twist(angular=Vector3(z=cls.turn))

    def test_it_stands_still_without_commands(self, drive: Drive) -> None:
        """Commands from before its activation have no effect."""
        total = odometry.traveled([arrival.message for arrival in drive.before])
        assert abs(total.ahead_m) <= self.still, f"it moves {total.ahead_m:.3f} m without a command"
        assert abs(total.left_rad) <= self.still, (
            f"it turns {total.left_rad:.3f} rad without a command"
        )

    def test_ahead_is_ahead(self, drive: Drive) -> None:
        """Speeds are in meters per second; forward (x in REP 103) is positive."""
        speed = _mean([odom.twist.twist.linear.x for odom in _second_half(drive.ahead)])
        total = odometry.traveled([arrival.message for arrival in drive.ahead])
        self._check_speed(speed, self.speed, "m/s ahead")
        assert total.ahead_m > 0.0, f"commanded ahead, it went {total.ahead_m:.3f} m by its poses"

    def test_left_is_left(self, drive: Drive) -> None:
        """Speeds are in radians per second; counterclockwise from above is positive (REP 103)."""
        turn = _mean([odom.twist.twist.angular.z for odom in _second_half(drive.left)])
        total = odometry.traveled([arrival.message for arrival in drive.left])
        self._check_speed(turn, self.turn, "rad/s to the left")
        assert total.left_rad > 0.0, f"commanded to the left, it turned {total.left_rad:.3f} rad"

    def _check_speed(self, speed: float, commanded: float, what: str) -> None:
        assert abs(speed - commanded) <= self.accuracy * commanded, (
            f"commanded {commanded:g} {what}, odometry reports {speed:.3f}"
        )


class SafetyContract(DriveContract):
    """The wheels stop if the commander or the driver fails in any way."""

    def test_it_stops_when_commands_stop(self, drive: Drive) -> None:
        """The commander may have terminated, hang or be unplugged."""
        ceased = timed.stamps_of(drive.left)[-1] + round(self.stop_limit_s * SECOND)
        stamps = timed.stamps_of(drive.after)
        late = [one for one, stamp in zip(drive.after, stamps, strict=True) if stamp > ceased]
        assert late, f"odometry ends less than {self.stop_limit_s:g} s after the last command"
        moving = [one for one in late if not self._is_still(one)]
        assert not moving, (
            f"{self.stop_limit_s:g} s after the last command it still moves: "
            f"{moving[-1].message.twist.twist}"
        )

    def test_its_wheels_stand_when_odometry_says_so(
        self, driving: Reading[Odometry], device: object
    ) -> None:
        """Odometry is that of the wheels, not of the commands."""
        if not isinstance(device, Wheeled):
            pytest.skip(_WHEELS_NOT_OBSERVED)
        self._await_stand(driving, driving.count)
        assert device.await_stand(self.stop_limit_s), "odometry shows no speed, but wheels turn"

    def test_deactivated_it_stops(
        self, robot: RunningDeployment, driving: Reading[Odometry], device: object
    ) -> None:
        """It stands also after it is activated again, until the next command."""
        robot.request(self.component, "deactivate")
        stood = not isinstance(device, Wheeled) or device.await_stand(self.stop_limit_s)
        before = driving.count
        robot.request(self.component, "activate")
        assert stood, f"wheels turn {self.stop_limit_s:g} s after {self.component} was deactivated"
        self._await_stand(driving, before)

    def test_its_wheels_stop_when_the_driver_hangs(
        self, robot: RunningDeployment, driving: Reading[Odometry], device: object
    ) -> None:
        """The driver's process is suspended (SIGSTOP): the device itself has to stop."""
        if not isinstance(device, Wheeled):
            pytest.skip(_WHEELS_NOT_OBSERVED)
        with robot.suspended(self.component):
            stood = device.await_stand(self.stop_limit_s)
        assert stood, f"wheels turn {self.stop_limit_s:g} s after {self.component} hung"
        self.await_working(driving, driving.count)

    def test_its_wheels_stop_when_the_driver_is_killed(
        self, robot: RunningDeployment, driving: Reading[Odometry], device: object
    ) -> None:
        """The driver's process is gone, or replaced: no command reaches the device."""
        if not isinstance(device, Wheeled):
            pytest.skip(_WHEELS_NOT_OBSERVED)
        robot.kill(self.component)
        stood = device.await_stand(self.stop_limit_s)
        assert stood, f"wheels turn {self.stop_limit_s:g} s after {self.component} was killed"
        self.await_working(driving, driving.count)

    def test_nan_commands_are_refused(
        self, robot: RunningDeployment, output: Reading[Odometry]
    ) -> None:
        """A command of NaN does not move it, and does not terminate the driver."""
        pid = robot.status(self.component).pid
        try:
            self._await_stand(output, 0)
        except AssertionError:
            pytest.skip("it does not stand without commands, so a movement would prove nothing")
        topic = self.topic(robot, "cmd_vel")
        plain = robot.encoded(Twist(linear=Vector3(x=1.5)))
        nan = plain.replace(struct.pack("<d", 1.5), struct.pack("<d", math.nan))
        for _ in range(3):
            robot.publish_bytes(topic, Twist, nan)
        robot.await_status(
            self.component,
            lambda status: any(p.port == "cmd_vel" and p.invalid for p in status.ports),
            "counting invalid commands",
        )
        later = self.sample(output, 5, after=output.count)
        assert all(map(self._is_still, later)), "a command of NaN has moved it"
        assert robot.status(self.component).pid == pid, "a command of NaN has terminated the driver"

    def test_speed_is_limited(self, robot: RunningDeployment, output: Reading[Odometry]) -> None:
        """A commander's mistake of units does not make the robot too fast."""
        if self.top_speed is None:
            pytest.skip("top_speed is not set")
        with robot.publishing(self.topic(robot, "cmd_vel"), Twist(linear=Vector3(x=1000.0))):
            odoms = self.sample(output, math.ceil(self.drive_s * self.rate_hz), after=output.count)
        fastest = odometry.traveled([arrival.message for arrival in odoms]).longest_speed
        assert fastest <= self.top_speed * (1.0 + self.accuracy), (
            f"commanded 1000 m/s it went {fastest:.3f} m/s; its limit is {self.top_speed:g} m/s"
        )

    def _await_stand(self, output: Reading[Odometry], after: int) -> None:
        output.await_that(
            lambda arrivals: any(map(self._is_still, arrivals)),
            "standing still, by odometry",
            after=after,
            limit_s=self.return_limit_s + self.stop_limit_s,
        )
        rest = self.sample(output, 3, after=output.count)
        assert all(map(self._is_still, rest)), "it stood, and moves again without a command"

    def _is_still(self, odom: Arrival[Odometry]) -> bool:
        return odometry.is_still(odom.message, self.still, self.still)


class BaseContract(
    EndContract, StopContract, UnplugContract, LifeCycleContract, SafetyContract, ParametersContract
):
    """All rules for a driver of a base; derive a class and set the attributes of your base."""


def _second_half(arrivals: Odoms) -> list[Odometry]:
    return [arrival.message for arrival in arrivals[len(arrivals) // 2 :]]


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
