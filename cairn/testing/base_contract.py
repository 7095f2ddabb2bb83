"""The contract of a base: input `cmd_vel` (geometry_msgs/Twist), outputs `odom` and `tf`.

The tests drive the robot a short distance ahead and turn it to the left on the spot. Give a real
robot half a meter of free space, or lift its wheels off the ground.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import ClassVar

import pytest

from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.system.clock import SECOND
from cairn.testing import odometry_contract as odometry
from cairn.testing import timing as timed
from cairn.testing.device import Wheeled
from cairn.testing.driver_contract import DriverContract
from cairn.testing.odometry_contract import Drive, OdometryContract, Odoms
from cairn.testing.robot import Arrival, Reading, RunningDeployment
from cairn.testing.timing import in_time

_WHEELS_NOT_OBSERVED = (
    "the wheels cannot be observed: the fixture `device` has no methods turns and await_stand"
)


class DriveContract(OdometryContract):
    """Tests that the base executes velocity commands, by its odometry."""

    speed: ClassVar[float] = 0.2
    """Speed at which the tests drive ahead [m/s]."""

    turn: ClassVar[float] = 0.5
    """Speed at which the tests turn [rad/s]."""

    drive_s: ClassVar[float] = 1.2
    """Duration of each motion [s]; the tests compare speeds in its second half."""

    still: ClassVar[float] = 0.02
    """Speed up to which the base counts as standing [m/s, rad/s]."""

    stop_limit_s: ClassVar[float] = 1.5
    """Time limit after the last command until the wheels stand, including braking [s]."""

    top_speed: ClassVar[float | None] = None
    """Maximum speed that the driver allows, whatever the command [m/s]; None: not tested."""

    @classmethod
    def record_drive(cls, robot: RunningDeployment) -> Drive:
        """Drive ahead, turn left and stop; return the odometry."""
        command = cls.topic(robot, "cmd_vel")
        span = max(2, math.ceil(cls.drive_s * cls.rate_hz))
        with cls.transforms_of(robot) as transforms:
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
            return Drive(
                before=arrivals[:started],
                ahead=arrivals[started:turned],
                left=arrivals[turned:ceased],
                after=arrivals[ceased:],
                transforms=None if transforms is None else transforms.messages,
            )

    @pytest.fixture
    def driving(self, robot: RunningDeployment, output: Reading[Odometry]) -> Reading[Odometry]:
        """Drive the base at `speed`, then stop sending commands; return its odometry."""
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
        """Return the command for driving ahead at `speed`."""
        return Twist(linear=Vector3(x=cls.speed))

    @classmethod
    def leftwards(cls) -> Twist:
        """Return the command for turning left on the spot at `turn`."""
        return Twist(angular=Vector3(z=cls.turn))

    def test_base_stands_still_without_commands(self, drive: Drive) -> None:
        """The base stands until it receives a command; earlier commands have no effect."""
        total = odometry.traveled([arrival.message for arrival in drive.before])
        assert abs(total.ahead_m) <= self.still, (
            f"the base moves {total.ahead_m:.3f} m without a command"
        )
        assert abs(total.left_rad) <= self.still, (
            f"the base turns {total.left_rad:.3f} rad without a command"
        )

    def test_forward_command_drives_forward(self, drive: Drive) -> None:
        """A positive linear.x drives forward (REP 103), in meters per second."""
        speed = _mean([odom.twist.twist.linear.x for odom in _second_half(drive.ahead)])
        total = odometry.traveled([arrival.message for arrival in drive.ahead])
        self._check_speed(speed, self.speed, "m/s ahead")
        assert total.ahead_m > 0.0, f"commanded ahead, it moved {total.ahead_m:.3f} m by its poses"

    def test_left_command_turns_left(self, drive: Drive) -> None:
        """A positive angular.z turns counterclockwise (REP 103), in radians per second."""
        turn = _mean([odom.twist.twist.angular.z for odom in _second_half(drive.left)])
        total = odometry.traveled([arrival.message for arrival in drive.left])
        self._check_speed(turn, self.turn, "rad/s to the left")
        assert total.left_rad > 0.0, f"commanded to the left, it turned {total.left_rad:.3f} rad"

    def _check_speed(self, speed: float, commanded: float, what: str) -> None:
        assert abs(speed - commanded) <= self.accuracy * commanded, (
            f"commanded {commanded:g} {what}, odometry reports {speed:.3f}"
        )


class SafetyContract(DriveContract):
    """Tests that the wheels stop when the sender of commands or the driver fails."""

    def test_base_stops_when_commands_stop(self, drive: Drive) -> None:
        """The base stops when commands cease: their sender may hang, be killed or be unplugged."""
        ceased = timed.stamps_of(drive.left)[-1] + round(self.stop_limit_s * SECOND)
        stamps = timed.stamps_of(drive.after)
        late = [one for one, stamp in zip(drive.after, stamps, strict=True) if stamp > ceased]
        assert late, f"odometry ends less than {self.stop_limit_s:g} s after the last command"
        moving = [one for one in late if not self._is_still(one)]
        assert not moving, (
            f"{self.stop_limit_s:g} s after the last command the base still moves: "
            f"{moving[-1].message.twist.twist}"
        )

    def test_wheels_stand_when_odometry_reports_rest(
        self, driving: Reading[Odometry], device: object
    ) -> None:
        """Odometry measures the wheels; it does not repeat the commands."""
        if not isinstance(device, Wheeled):
            pytest.skip(_WHEELS_NOT_OBSERVED)
        self._await_stand(driving, driving.count)
        assert self._stand_in_time(device), "odometry reports no speed, but the wheels turn"

    def test_deactivated_base_stops(
        self, robot: RunningDeployment, driving: Reading[Odometry], device: object
    ) -> None:
        """A deactivated base stops. After reactivation it stands until the next command."""
        robot.request(self.component, "deactivate")
        try:
            stood = not isinstance(device, Wheeled) or self._stand_in_time(device)
        finally:
            before = driving.count
            robot.request(self.component, "activate")
        assert stood, f"wheels turn {self.stop_limit_s:g} s after {self.component} was deactivated"
        self._await_stand(driving, before)

    def test_wheels_stop_when_the_driver_hangs(
        self, robot: RunningDeployment, driving: Reading[Odometry], device: object
    ) -> None:
        """The device stops the wheels when the driver's process is suspended (SIGSTOP)."""
        if not isinstance(device, Wheeled):
            pytest.skip(_WHEELS_NOT_OBSERVED)
        with robot.suspended(self.component):
            stood = self._stand_in_time(device)
        assert stood, f"wheels turn {self.stop_limit_s:g} s after {self.component} hung"
        robot.await_active(self.component)
        self.await_working(driving, driving.count)

    def test_wheels_stop_when_the_driver_is_killed(
        self, robot: RunningDeployment, driving: Reading[Odometry], device: object
    ) -> None:
        """The device stops the wheels when the driver's process is killed."""
        if not isinstance(device, Wheeled):
            pytest.skip(_WHEELS_NOT_OBSERVED)
        pid = robot.kill(self.component)
        stood = self._stand_in_time(device)
        assert stood, f"wheels turn {self.stop_limit_s:g} s after {self.component} was killed"
        robot.await_active(self.component, other_than=pid)
        self.await_working(driving, driving.count)

    def test_nan_commands_are_rejected(
        self, robot: RunningDeployment, output: Reading[Odometry]
    ) -> None:
        """A NaN command is counted as invalid; it neither moves the base nor ends the driver."""
        pid = robot.status(self.component).pid
        try:
            self._await_stand(output, 0)
        except AssertionError:
            pytest.skip("the base does not stand without commands, so the test proves nothing")
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
        assert all(map(self._is_still, later)), "a NaN command has moved the base"
        assert robot.status(self.component).pid == pid, "a NaN command has terminated the driver"

    def test_speed_is_limited(self, robot: RunningDeployment, output: Reading[Odometry]) -> None:
        """A command of 1000 m/s, such as a mistake of units, does not exceed `top_speed`."""
        if self.top_speed is None:
            pytest.skip("top_speed is not set")
        with robot.publishing(self.topic(robot, "cmd_vel"), Twist(linear=Vector3(x=1000.0))):
            odoms = self.sample(output, math.ceil(self.drive_s * self.rate_hz), after=output.count)
        fastest = odometry.traveled([arrival.message for arrival in odoms]).longest_speed
        assert fastest <= self.top_speed * (1.0 + self.accuracy), (
            f"commanded 1000 m/s it drove {fastest:.3f} m/s; its limit is {self.top_speed:g} m/s"
        )

    def _await_stand(self, output: Reading[Odometry], after: int) -> None:
        output.await_that(
            lambda arrivals: any(map(self._is_still, arrivals)),
            "standing still, by odometry",
            after=after,
            limit_s=self.return_limit_s + self.stop_limit_s,
        )
        rest = self.sample(output, 3, after=output.count)
        assert all(map(self._is_still, rest)), "the base stood, but moves again without a command"

    def _stand_in_time(self, device: Wheeled) -> bool:
        return in_time(lambda: device.await_stand(self.stop_limit_s))

    def _is_still(self, odom: Arrival[Odometry]) -> bool:
        return odometry.is_still(odom.message, self.still, self.still)


class BaseContract(DriverContract, SafetyContract):
    """All tests of a base driver. Derive a class and set the attributes of your base."""


def _second_half(arrivals: Odoms) -> list[Odometry]:
    return [arrival.message for arrival in arrivals[len(arrivals) // 2 :]]


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
