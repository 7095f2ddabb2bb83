"""The driver in a process of its own: the contract, a square, wheels that stop in any case."""

import math
import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from cairn.testing.base_contract import BaseContract
from cairn.testing.bench import Bench, settings
from cairn.testing.robot import Robot
from planar.messages import planar_pose
from planar.poses import Pose, wrap
from schemas.diagnostic_msgs import DiagnosticArray
from schemas.geometry_msgs import Twist, Vector3
from schemas.nav_msgs import Odometry
from schemas.sensor_msgs import BatteryState
from tests.components.roboclaw.emulated_base import DEPLOYMENT, EmulatedBase, emulated_base

pytestmark = pytest.mark.realtime

AHEAD = Twist(linear=Vector3(x=0.5))
DEVICE_TIMEOUT_S = 1.0  # as in the deployment


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedBase]:
    with emulated_base(tmp_path_factory.mktemp("line")) as base:
        yield base


@pytest.fixture(scope="module")
def bench(base: EmulatedBase, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with Bench(tmp_path_factory.mktemp("robot"), DEPLOYMENT, settings(base.settings)) as bench:
        yield bench


@pytest.fixture
def robot(bench: Bench) -> Robot:
    return bench.robot("base")


@pytest.fixture(scope="module")
def device(base: EmulatedBase) -> EmulatedBase:
    return base


def test_a_square_by_odometry_is_the_square_of_the_wheels(robot: Robot, base: EmulatedBase) -> None:
    with robot.read("odom", Odometry) as odom:

        def turned_to(heading: float) -> None:
            odom.await_that(
                lambda arrivals: any(
                    abs(wrap(planar_pose(one.message.pose.pose)[2] - heading)) < 0.15
                    for one in arrivals
                ),
                f"a heading of {heading:.2f} rad",
                after=odom.count,
            )

        def gone(way: float) -> None:
            start = odom.messages[-1].pose.pose.position
            odom.await_that(
                lambda arrivals: any(
                    math.hypot(
                        one.message.pose.pose.position.x - start.x,
                        one.message.pose.pose.position.y - start.y,
                    )
                    > way
                    for one in arrivals
                ),
                f"a way of {way} m",
                after=odom.count,
            )

        odom.await_count(2)
        for side in range(4):
            with robot.sending("cmd_vel", AHEAD):
                gone(0.2)
            with robot.sending("cmd_vel", Twist(angular=Vector3(z=2.0))):
                turned_to(wrap((side + 1) * math.pi / 2))
        assert base.await_stand(2.0)
        true = base.true_pose()
        odom.await_that(
            lambda arrivals: any(_near(one.message, true) for one in arrivals),
            f"the pose to which the wheels have led, {true}",
            after=odom.count,
        )
    left = [step.turned[0] for step in base.moved()]
    assert max(left) - min(left) > 4000, "the wheels have hardly turned"


def _near(odom: Odometry, true: Pose) -> bool:
    x, y, heading = planar_pose(odom.pose.pose)
    # A busy computer reads the encoders seldom, and takes the way between for an arc.
    return math.hypot(x - true[0], y - true[1]) < 0.02 and abs(wrap(heading - true[2])) < 0.03


def drive(robot: Robot, base: EmulatedBase) -> None:
    """Bring the wheels to a speed with commands that have just ended."""
    with robot.sending("cmd_vel", AHEAD):
        assert base.await_that(lambda: base.speed() > 0.4)


def test_wheels_stop_when_commands_cease(robot: Robot, base: EmulatedBase) -> None:
    before = base.device.timeouts
    drive(robot, base)

    assert base.await_stand(2.0)
    assert base.device.timeouts == before  # by the driver


def test_wheels_of_a_driver_that_hangs_are_stopped_by_the_controller(
    robot: Robot, base: EmulatedBase
) -> None:
    pid = robot.status("base").pid
    before = base.device.timeouts
    with ExitStack() as commands:
        commands.enter_context(robot.sending("cmd_vel", AHEAD))
        assert base.await_that(lambda: base.speed() > 0.4)
        os.kill(pid, signal.SIGSTOP)
        stopped = time.monotonic()
        try:
            assert base.await_stand(3.0)
            assert base.device.timeouts == before + 1
            # Nothing is said any more, so the controller drives on until its timeout, no longer.
            coasting = 0.5
            assert base.fastest_since(stopped + DEVICE_TIMEOUT_S + coasting) < 0.05
        finally:
            commands.close()
            os.kill(pid, signal.SIGCONT)
    awake = time.monotonic()
    with robot.read("odom", Odometry) as odom:
        odom.await_count(20)
    assert base.fastest_since(awake) < 0.05, "it went on where it was interrupted"


def test_wheels_of_a_driver_that_is_killed_stop(robot: Robot, base: EmulatedBase) -> None:
    pid = robot.status("base").pid
    drive(robot, base)
    robot.kill("base")

    assert base.await_stand(3.0)
    robot.await_status("base", lambda now: now.pid != pid and now.state == "active", "active again")


def test_deactivated_it_leaves_wheels_that_stand(robot: Robot, base: EmulatedBase) -> None:
    before = base.device.timeouts
    drive(robot, base)
    robot.request("base", "deactivate")

    assert not base.turns()
    assert base.device.timeouts == before  # it has waited for them to stand


def test_it_tells_of_battery_and_health(robot: Robot, base: EmulatedBase) -> None:
    with (
        robot.read("battery_state", BatteryState) as battery,
        robot.read("diagnostics", DiagnosticArray) as health,
    ):
        (state,) = (arrival.message for arrival in battery.await_count(1))
        health.await_that(
            lambda arrivals: any(
                one.message.status[0].hardware_id == "USB Roboclaw 2x7a v4.2.8" for one in arrivals
            ),
            "the health of a controller that is known",
        )
        status = health.messages[-1].status[0]

    assert state.voltage == pytest.approx(12.4)
    assert status.level <= 1, status.message  # a busy computer may be told of as slow
    told = {pair.key: pair.value for pair in status.values}
    assert told["main battery [V]"] == "12.4"
    assert told["temperature [deg C]"] == "31.5"
    assert told["errors"] == told["wheel fault"] == "none"
    assert float(told["rate [Hz]"]) > 0.0


class TestRoboclawBase(BaseContract):
    rate_hz = 40.0
    top_speed = 0.8
    turn = 1.0
    stop_limit_s = 2.5  # the controller's own time limit is 1 s
    cycles = 6
