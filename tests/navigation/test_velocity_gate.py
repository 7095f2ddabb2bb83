"""The velocity gate in the whole system: emergency stop, operator, obstacles before the robot."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

import cairn.client
from cairn.deployment.load import load_deployment
from cairn.deployment.problems import DeploymentError
from cairn.planar.poses import distance
from cairn.schemas.cairn_nav_msgs import NavigationStatus, ReasonCode
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.testing.robot import RunningDeployment
from tests.commands import Answer
from tests.commands import cairn as run_cairn
from tests.navigation.driving import SIM, STOPS_S, LockstepRobot
from tests.navigation.processes import ObservedRobot, robot_in

RobotFactory = Callable[..., LockstepRobot]


def test_goal_waits_during_an_emergency_stop_and_goes_on_after_release(
    drive: RobotFactory,
) -> None:
    robot = drive()
    robot.go(4.0, 1.4)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(4.0)

    robot.request("velocity_gate", "stop", reason="test")
    assert robot.time_to_stand() <= STOPS_S
    robot.run_for(25.0)  # after 20 s without progress it would recover
    waiting = robot.statuses[-1]
    assert waiting.state == NavigationStatus.DRIVING
    assert waiting.reason_code == ReasonCode.EMERGENCY_STOP
    assert waiting.recoveries == 0
    assert robot.stands()

    robot.request("velocity_gate", "release_stop")
    robot.assert_arrives((4.0, 1.4))


def test_navigator_waits_while_an_operator_has_the_lease(drive: RobotFactory) -> None:
    robot = drive()
    robot.go(4.0, 1.4)
    robot.await_state(NavigationStatus.DRIVING)
    robot.run_for(4.0)

    robot.request("velocity_gate", "acquire_lease", operator="anna", seconds=20.0)
    assert robot.time_to_stand() <= STOPS_S
    robot.run_for(10.0)
    assert robot.stands()
    assert robot.statuses[-1].reason_code == ReasonCode.OPERATOR_DRIVES

    robot.assert_arrives((4.0, 1.4))  # once the lease has ended by itself


@pytest.mark.parametrize(
    ("value", "parameter", "other"),
    [
        ("motion_control.parameters.speed=0.9", "velocity_gate.parameters.speed", "motion_control"),
        (
            "motion_control.parameters.acceleration=1.6",
            "velocity_gate.parameters.deceleration",
            "motion_control",
        ),
        ("base.parameters.acceleration=0.5", "velocity_gate.parameters.braking", "base"),
    ],
)
def test_check_reports_limits_that_do_not_fit_navigator_or_base(
    value: str, parameter: str, other: str
) -> None:
    with pytest.raises(DeploymentError) as failed:
        load_deployment(SIM, sets=[f"components.{value}"])
    problems = {problem.path: problem for problem in failed.value.problems}
    problem = problems[f"components.{parameter}"]
    assert other in problem.found
    assert other in problem.remedy


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObservedRobot]:
    """A robot in real processes; the last test engages its emergency stop."""
    renamed = "components.velocity_gate.topics.teleoperation=joystick"
    with robot_in(tmp_path_factory.mktemp("robot"), renamed) as robot:
        yield robot


@pytest.mark.processes
def test_forged_commands_do_not_move_the_robot_and_their_publisher_is_named(
    robot: ObservedRobot,
) -> None:
    ahead = Twist(linear=Vector3(x=0.4))
    with closing(RunningDeployment(robot.run)) as intruder:
        begin = robot.pose
        with intruder.publishing("cmd_vel", ahead), intruder.publishing("navigator_cmd_vel", ahead):
            for component in ("base", "velocity_gate"):  # 2 s of commands at 20 Hz
                intruder.await_status(
                    component,
                    lambda status: any(port.refused >= 40 for port in status.ports),
                    "refusing 40 commands",
                )
        assert distance(begin, robot.pose) < 0.001
        for component in ("base", "velocity_gate"):
            assert "refused message on" in robot.run.log_of(component)
            assert "/conformance" in robot.run.log_of(component)


@pytest.mark.processes
def test_stop_command_works_while_the_supervisor_is_stopped(robot: ObservedRobot) -> None:
    endpoint = robot.run.endpoint
    with cairn.client.connect(endpoint) as client, client.teleoperation("anna") as drive:
        assert isinstance(drive, cairn.client.Teleoperation)
        begin = robot.pose
        drive(0.3, 0.0, seconds=2.0)
        assert distance(begin, robot.pose) > 0.2
    stopped = _stop_while_suspended(robot, "mobile_supervisor")
    assert stopped.code == 0, stopped.err
    assert "emergency stop" in stopped.out

    failed = _stop_while_suspended(robot, "velocity_gate")
    assert failed.code == 1
    assert "press the robot's own emergency stop" in failed.err
    assert run_cairn("stop", "--release", connect=endpoint).code == 0


def _stop_while_suspended(robot: ObservedRobot, component: str) -> Answer:
    """Run `cairn stop` while a component's process is suspended (SIGSTOP)."""
    process = robot.run.pid_of(component)
    os.kill(process, signal.SIGSTOP)
    try:
        return run_cairn("stop", connect=robot.run.endpoint)
    finally:
        os.kill(process, signal.SIGCONT)
