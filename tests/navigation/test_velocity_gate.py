"""The velocity gate in the whole system: emergency stop, operator, obstacles before the robot."""

from collections.abc import Callable

import pytest

from cairn.deployment.load import load_deployment
from cairn.deployment.problems import DeploymentError
from cairn.schemas.cairn_nav_msgs import NavigationStatus, ReasonCode
from tests.navigation.driving import SIM, STOPS_S, LockstepRobot

RobotFactory = Callable[..., LockstepRobot]


@pytest.mark.accuracy
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


@pytest.mark.accuracy
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
