"""The base on an emulated RoboClaw fulfills the base contract, and its own promises."""

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose, apart, distance, relative, wrap
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import BatteryState
from cairn.testing.base_contract import BaseContract, SafetyContract
from cairn.testing.driver_contract import Contract
from cairn.testing.robot import Arrival, Reading, RunningDeployment
from cairn.testing.timing import undisturbed
from tests.components.base_life import BaseLifeContract
from tests.components.roboclaw_base.emulated_base import DEPLOYMENT, EmulatedBase, emulated_base
from tests.patience import LIMIT_S

FORWARD = Twist(linear=Vector3(x=0.5))
LEFT = Twist(angular=Vector3(z=2.0))
DEVICE_TIMEOUT_S = 1.0  # as in the deployment
COASTING_S = 0.5  # of motors without power


class EmulatedRoboclaw(Contract):
    """The base of both contracts, with a controller for each class."""

    deployment = DEPLOYMENT
    component, port, message = "base", "odom", Odometry
    rate_hz = 20.0

    @pytest.fixture(scope="class")
    @classmethod
    def device(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedBase]:
        with emulated_base(tmp_path_factory.mktemp("line")) as base:
            yield base


@pytest.mark.accuracy
class TestRoboclawLife(EmulatedRoboclaw, BaseLifeContract):
    """The base without tests in real time."""


@pytest.mark.accuracy
@pytest.mark.realtime
class TestRoboclawBase(EmulatedRoboclaw, SafetyContract):
    top_speed = 0.8
    turn = 1.0
    stop_limit_s = 2.5  # the controller's own time limit is 1 s
    return_limit_s = LIMIT_S

    def test_square_by_odometry_is_the_true_square(
        self, robot: RunningDeployment, output: Reading[Odometry], device: EmulatedBase
    ) -> None:
        def drive_square() -> tuple[Pose, Pose]:
            """Return where it begins by odometry, and the true way."""
            assert device.await_stand(LIMIT_S)
            true_start = device.true_pose()
            (first,) = output.await_count(1, after=output.count)
            for _ in range(4):
                with robot.publishing("cmd_vel", FORWARD):
                    _await_distance(output, 0.2)
                with robot.publishing("cmd_vel", LEFT):
                    _await_turn(output, math.pi / 2)
            assert device.await_stand(LIMIT_S)
            return _pose(first), relative(true_start, device.true_pose())

        # A busy computer reads the encoders rarely, and takes the path between for an arc.
        start, true_way = undisturbed(drive_square)
        output.await_that(
            lambda arrivals: any(
                not apart(relative(start, _pose(one)), true_way, 0.02, 0.03) for one in arrivals
            ),
            f"a pose {true_way} from {start}, as the wheels moved",
            after=output.count,
        )

    def test_hanging_driver_is_stopped_by_the_controller_and_continues_from_rest(
        self, robot: RunningDeployment, output: Reading[Odometry], device: EmulatedBase
    ) -> None:
        before = device.device.timeouts
        with ExitStack() as commands:
            commands.enter_context(robot.publishing("cmd_vel", FORWARD))
            assert device.await_that(lambda: device.speed() > 0.4)
            with robot.suspended("base"):
                for _ in range(2):  # after the second call it has read all packets
                    device.call(lambda: None)
                hung = time.monotonic()
                assert device.await_stand(LIMIT_S)
                assert device.device.timeouts > before
                # No packets arrive: the controller drives on until its timeout, no longer.
                assert device.fastest_since(hung + DEVICE_TIMEOUT_S + COASTING_S) < 0.05
                commands.close()
        awake = time.monotonic()
        output.await_count(10, after=output.count)
        assert device.fastest_since(awake) < 0.05, "it continued the interrupted motion"

    def test_driver_stops_the_wheels_before_the_controller_does(
        self, robot: RunningDeployment, device: EmulatedBase
    ) -> None:
        def drive_and_stop() -> tuple[bool, int]:
            """Return whether the wheels turn, and how often the controller has stopped them."""
            before = device.device.timeouts
            _drive(robot, device)
            assert device.await_stand(LIMIT_S), "commands have ceased"
            _drive(robot, device)
            robot.request("base", "deactivate")
            stopped = device.turns(), device.device.timeouts - before
            robot.request("base", "activate")
            return stopped

        turns, timeouts = undisturbed(drive_and_stop)
        assert not turns, "deactivation did not wait for the wheels"
        assert timeouts == 0

    def test_battery_and_health_are_published(self, robot: RunningDeployment) -> None:
        with (
            robot.read("battery_state", BatteryState) as battery,
            robot.read("diagnostics", DiagnosticArray) as health,
        ):
            battery.await_count(1)
            health.await_that(
                lambda arrivals: any(_values(one).items() >= HEALTHY.items() for one in arrivals),
                f"health with {HEALTHY}",
            )
        assert battery.messages[0].voltage == pytest.approx(12.4)

    def test_driver_restarted_while_unplugged_waits_for_the_controller(
        self, robot: RunningDeployment, output: Reading[Odometry], device: EmulatedBase
    ) -> None:
        lines = len(robot.run.lines)
        device.unplug()
        try:
            robot.restart("base")
            lines = robot.run.await_line("cannot be opened: No such file", after=lines)
        finally:
            device.plug_in()
        self.await_working(output, output.count)
        robot.run.await_line("v4.2.8 on .* works again", after=lines)


HEALTHY = {
    "hardware": "USB Roboclaw 2x7a v4.2.8",
    "main battery [V]": "12.4",
    "temperature [deg C]": "31.5",
    "errors": "none",
    "wheel fault": "none",
}


def _values(health: Arrival[DiagnosticArray]) -> dict[str, str]:
    status = health.message.status[0]
    values = {pair.key: pair.value for pair in status.values}
    return {"hardware": status.hardware_id, **values}


def _drive(robot: RunningDeployment, base: EmulatedBase) -> None:
    """Bring the wheels to a speed with commands that end then."""
    with robot.publishing("cmd_vel", FORWARD):
        assert base.await_that(lambda: base.speed() > 0.4)


def _await_distance(odom: Reading[Odometry], length: float) -> None:
    start = _pose(odom.arrivals[-1])
    odom.await_that(
        lambda arrivals: any(distance(start, _pose(one)) > length for one in arrivals),
        f"a distance of {length} m",
        after=odom.count,
    )


def _await_turn(odom: Reading[Odometry], turn: float) -> None:
    start = _pose(odom.arrivals[-1])[2]
    odom.await_that(
        lambda arrivals: any(wrap(_pose(one)[2] - start) > turn - 0.15 for one in arrivals),
        f"a turn of {turn:.2f} rad to the left",
        after=odom.count,
    )


def _pose(odom: Arrival[Odometry]) -> Pose:
    return planar_pose(odom.message.pose.pose)


def test_both_classes_together_run_the_whole_contract() -> None:
    run = {name for one in (TestRoboclawLife, TestRoboclawBase) for name in dir(one)}

    assert {name for name in dir(BaseContract) if name.startswith("test_")} <= run
