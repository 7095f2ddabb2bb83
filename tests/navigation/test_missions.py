"""Missions of a deployment, which ends when its mission ends."""

import re
from collections.abc import Callable

import pytest

from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.testing.launching import Launching
from tests.navigation.driving import LockstepRobot
from tests.wording import assert_words

pytestmark = pytest.mark.processes


RobotFactory = Callable[..., LockstepRobot]
REACHABLE = "settings.mission=[[2.0, 1.2, 0.0], [1.2, 1.2, 3.1]]"
OUTSIDE = "settings.mission=[[50.0, 1.2, 0.0]]"
FINISH = "settings.finish=true"


def test_finished_mission_ends_the_deployment(drive: RobotFactory) -> None:
    robot = drive(REACHABLE, FINISH)

    robot.run_until(lambda: robot.end is not None, 60.0)

    assert robot.end is not None
    assert robot.end.normal
    assert robot.end.success
    assert_words(robot.end.reason, "mobile_supervisor", "mission succeeded", "(1.20, 1.20)")


def test_failed_mission_ends_the_deployment_without_success(drive: RobotFactory) -> None:
    robot = drive(OUTSIDE, FINISH)

    robot.run_until(lambda: robot.end is not None, 60.0)

    assert robot.end is not None
    assert robot.end.normal
    assert not robot.end.success
    assert "the mission failed: " in robot.end.reason


def test_preempted_mission_ends_the_deployment_with_the_new_mission(
    drive: RobotFactory,
) -> None:
    robot = drive(REACHABLE, FINISH)
    robot.await_state(NavigationStatus.DRIVING)

    robot.go(1.6, 1.2)
    robot.assert_arrives((1.6, 1.2))

    robot.run_until(lambda: robot.end is not None, 5.0)
    assert robot.end is not None
    assert robot.end.normal
    assert not robot.end.success
    assert re.fullmatch(
        r"mobile_supervisor has finished: the mission was preempted by mission \d+, which "
        r"succeeded: arrived at \(1.60, 1.20\)",
        robot.end.reason,
    )


def test_preempted_mission_without_finish_ends_nothing(drive: RobotFactory) -> None:
    robot = drive(REACHABLE)
    robot.await_state(NavigationStatus.DRIVING)

    robot.go(1.6, 1.2)
    robot.assert_arrives((1.6, 1.2))

    robot.run_for(1.0)
    assert robot.end is None


# Without a simulated robot, whose missions fail in lockstep above: here `cairn up` has to fail.
FAILING = """
    components:
      mobile_supervisor:
        plugin: mobile_supervisor
        parameters: {mission: [[1.0, 1.0, 0.0]], finish: true}
        restart: transient
        significant: true
        children:
          automove:
            plugin: automove
            children:
              base:
                plugin: test_faulty
                load: on_request
                parameters: {fault: raise, where: on_activate}
    """


def test_failed_mission_in_processes_exits_with_1(launch: Launching) -> None:
    run = launch(FAILING)

    assert run.await_end() == 1

    run.await_line(
        "cairn: deployment0.yaml failed: mobile_supervisor has finished: the mission failed: "
    )
    assert "killed by" not in str(run)
    assert "restarting" not in str(run)
