"""AutoMove on a bus in virtual time: it loads plugins, sends commands and publishes progress."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from cairn import LATCHED, SECOND
from cairn.components.automove.component import AutoMove
from cairn.planar.messages import packed_poses, planar_pose, pose_message
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigateGoal,
    NavigationStatus,
    Plan,
)
from cairn.schemas.geometry_msgs import PoseWithCovariance
from cairn.system.clock import SimulatedClock
from cairn.testing.lockstep import DeploymentHarness
from tests.wording import assert_words

PLUGINS = """
cairn: 1
robot: robot
components:
  automove:
    plugin: automove
    children:
      beacon: {plugin: test_beacon, load: on_request}
      talker: {plugin: test_talker, load: on_request, parameters: {words: 1000000}}
"""
BROKEN = """
cairn: 1
robot: robot
components:
  automove:
    plugin: automove
    children:
      base: {plugin: test_faulty, load: on_request, parameters: {fault: raise, where: on_activate}}
"""
MakeHarness = Callable[..., DeploymentHarness]


@pytest.fixture
def make_harness(tmp_path: Path) -> Iterator[MakeHarness]:
    harnesses: list[DeploymentHarness] = []

    def make(text: str, *sets: str) -> DeploymentHarness:
        file = tmp_path / "deployment.yaml"
        file.write_text(text, encoding="utf-8")
        harnesses.append(DeploymentHarness(file, sets=sets))
        return harnesses[-1]

    yield make
    for one in harnesses:
        one.shutdown()


def mission(number: int, *goals: tuple[float, float, float], first: int = 0) -> NavigateGoal:
    """Return the message that starts a mission, or cancels it if there are no goals."""
    rows = np.array(goals, np.float64).reshape(-1, 3)
    return NavigateGoal(mission_id=number, first=first, goals=packed_poses(rows))


def test_mission_loads_the_plugins_and_publishes_each(make_harness: MakeHarness) -> None:
    robot = make_harness(PLUGINS)
    statuses = robot.read("navigation_status", NavigationStatus)
    robot.run_for(1.0)
    assert statuses.take() == []

    robot.publish("navigate_goal", mission(7, (1.0, 2.0, 0.5)), qos=LATCHED)
    reported = statuses.take()
    assert [(s.mission_id, s.state, s.reason) for s in reported] == [
        (7, NavigationStatus.LOADING, "beacon"),
        (7, NavigationStatus.LOADING, "talker"),
        (7, NavigationStatus.LOCALIZING, ""),
        (7, NavigationStatus.LOCALIZING, "no estimate from the localizer yet"),
    ]


def test_plugin_that_cannot_be_loaded_fails_the_mission(make_harness: MakeHarness) -> None:
    robot = make_harness(BROKEN)
    statuses = robot.read("navigation_status", NavigationStatus)
    for number in (1, 2):
        robot.publish("navigate_goal", mission(number, (1.0, 2.0, 0.5)), qos=LATCHED)
        last = statuses.take()[-1]
        assert (last.mission_id, last.state) == (number, NavigationStatus.FAILED)
        assert_words(
            last.reason, "plugins", "base: activate failed", "ValueError: broken on purpose"
        )
    assert robot.end is None


def test_command_is_published_on_change_and_twice_a_second(make_harness: MakeHarness) -> None:
    robot = make_harness(PLUGINS)
    nav_commands, statuses = (
        robot.read("nav_command", NavCommand),
        robot.read("navigation_status", NavigationStatus),
    )
    robot.publish("localization", LocalizationEstimate(located=True, health=0.9))
    robot.publish(
        "navigate_goal", mission(1, (1.0, 2.0, 0.5), (3.0, 4.0, 0.0), first=1), qos=LATCHED
    )
    robot.run_for(0.1)
    command = nav_commands.take()[-1]
    assert command.behavior == NavCommand.FOLLOW
    assert planar_pose(command.goal) == pytest.approx((3.0, 4.0, 0.0))
    assert (command.position_tolerance, command.heading_tolerance) == (0.1, 0.1)

    robot.publish("plan", Plan(command_id=command.command_id), qos=LATCHED)
    robot.publish(
        "motion_status",
        MotionStatus(command_id=command.command_id, state=MotionStatus.MOVING, distance_left=2.0),
    )
    robot.run_for(1.0)
    assert 2 <= len(nav_commands.take()) <= 4
    reported = statuses.take()[-1]
    assert (reported.state, reported.goal, reported.goals) == (NavigationStatus.DRIVING, 1, 2)
    assert (reported.distance_left, reported.time_left) == (2.0, 5.0)
    assert reported.elapsed == pytest.approx(1.1, abs=0.5)

    robot.publish(
        "motion_status", MotionStatus(command_id=command.command_id, state=MotionStatus.DONE)
    )
    ended = statuses.take()[-1]
    assert ended.state == NavigationStatus.SUCCEEDED
    assert nav_commands.take()[-1].behavior == NavCommand.STAND

    robot.run_for(3.0)
    assert statuses.take()[-1].elapsed == pytest.approx(ended.elapsed, abs=0.2)


@pytest.mark.parametrize(
    ("motion", "amount", "behavior", "commanded"),
    [
        (NavigateGoal.TURN, -1.5, NavCommand.TURN, (-1.5, 0.0)),
        (NavigateGoal.REVERSE, 0.3, NavCommand.REVERSE, (0.0, 0.3)),
        (NavigateGoal.REVERSE, -0.3, NavCommand.REVERSE, (0.0, 0.3)),
    ],
)
def test_motion_is_commanded_and_ends_with_motion_control(
    make_harness: MakeHarness,
    motion: int,
    amount: float,
    behavior: int,
    commanded: tuple[float, float],
) -> None:
    robot = make_harness(PLUGINS)
    nav_commands = robot.read("nav_command", NavCommand)
    statuses = robot.read("navigation_status", NavigationStatus)
    goal = NavigateGoal(mission_id=1, motion=motion, amount=amount, speed=0.5)
    robot.publish("navigate_goal", goal, qos=LATCHED)
    robot.run_for(0.1)
    command = nav_commands.take()[-1]
    assert command.behavior == behavior
    assert (command.angle, command.distance, command.speed) == (*commanded, 0.5)

    # The time that is left is infinite in floating point: AutoMove reports the longest one.
    moving = MotionStatus(
        command_id=command.command_id, state=MotionStatus.MOVING, distance_left=1.7e308
    )
    robot.publish("motion_status", moving)
    robot.run_for(1.0)
    assert statuses.take()[-1].state == NavigationStatus.DRIVING

    robot.publish(
        "motion_status", MotionStatus(command_id=command.command_id, state=MotionStatus.DONE)
    )
    assert statuses.take()[-1].state == NavigationStatus.SUCCEEDED
    assert nav_commands.take()[-1].behavior == NavCommand.STAND


@pytest.mark.parametrize("step_s", [-3600, 3600], ids=["back", "ahead"])
def test_step_of_the_clock_fails_no_mission(
    make_harness: MakeHarness, monkeypatch: pytest.MonkeyPatch, step_s: int
) -> None:
    clock = SimulatedClock()
    monkeypatch.setattr(AutoMove, "clock", clock)
    robot = make_harness(PLUGINS)
    nav_commands = robot.read("nav_command", NavCommand)
    statuses = robot.read("navigation_status", NavigationStatus)

    def pass_time(seconds: float, motion: MotionStatus | None = None) -> None:
        for _ in range(round(10 * seconds)):
            clock.set(clock.now() + SECOND // 10)
            robot.publish("localization", LocalizationEstimate(located=True, health=0.9))
            if motion is not None:
                robot.publish("motion_status", motion)
            robot.run_for(0.1)

    clock.set(10_000 * SECOND)
    robot.publish("navigate_goal", mission(1, (1.0, 2.0, 0.5)), qos=LATCHED)
    pass_time(0.2)
    command_id = nav_commands.take()[-1].command_id
    robot.publish("plan", Plan(command_id=command_id), qos=LATCHED)
    moving = MotionStatus(command_id=command_id, state=MotionStatus.MOVING, distance_left=2.0)
    pass_time(1.0, moving)
    clock.set(clock.now() + step_s * SECOND)
    # To motion control the last command is an hour old until the next one comes.
    stopped = MotionStatus(
        command_id=command_id, state=MotionStatus.STOPPED, reason="no nav_command"
    )
    pass_time(0.3, stopped)
    pass_time(1.0, moving)

    reported = statuses.take()
    assert reported[-1].state == NavigationStatus.DRIVING
    assert not any(one.state == NavigationStatus.FAILED for one in reported)
    assert (reported[-1].recoveries, reported[-1].elapsed < 10.0) == (0, True)

    pass_time(16.0, stopped)  # what is missing all the time fails the mission
    assert statuses.take()[-1].state == NavigationStatus.FAILED


def test_time_in_which_plugins_are_loaded_is_part_of_the_mission(
    make_harness: MakeHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimulatedClock()
    clock.set(10_000 * SECOND)
    monkeypatch.setattr(AutoMove, "clock", clock)
    monkeypatch.setattr(AutoMove, "_load", lambda *_: clock.set(clock.now() + 5 * SECOND))
    robot = make_harness(PLUGINS)
    statuses = robot.read("navigation_status", NavigationStatus)

    robot.publish("navigate_goal", mission(1, (1.0, 2.0, 0.5)), qos=LATCHED)

    assert statuses.take()[-1].elapsed == pytest.approx(10.0)  # of two plugins


def test_give_way_recovery_sends_a_goal_to_the_planner(make_harness: MakeHarness) -> None:
    robot = make_harness(PLUGINS)
    nav_commands = robot.read("nav_command", NavCommand)
    for x in range(11):
        pose = PoseWithCovariance(pose=pose_message((0.2 * x, 0.0, 0.0)))
        robot.publish("localization", LocalizationEstimate(located=True, pose=pose, health=0.9))
    robot.publish("navigate_goal", mission(1, (4.0, 0.0, 0.5)), qos=LATCHED)

    goals = []
    for _ in range(120):
        robot.publish("localization", LocalizationEstimate(located=True, pose=pose, health=0.9))
        for command in nav_commands.take():
            if command.behavior == NavCommand.FOLLOW:
                goals.append(planar_pose(command.goal)[0])
                robot.publish(
                    "plan",
                    Plan(command_id=command.command_id, outcome=Plan.GOAL_BLOCKED),
                    qos=LATCHED,
                )
        robot.run_for(0.1)

    assert goals[0] == pytest.approx(4.0)
    assert pytest.approx(0.6) in goals


@pytest.mark.parametrize(
    ("sets", "state"),
    [
        ((), NavigationStatus.SUCCEEDED),
        (("components.automove.parameters.sure_health=0.8",), NavigationStatus.RECOVERING),
    ],
)
def test_sure_health_is_configurable(
    make_harness: MakeHarness, sets: tuple[str, ...], state: int
) -> None:
    robot = make_harness(PLUGINS, *sets)
    statuses, nav_commands = (
        robot.read("navigation_status", NavigationStatus),
        robot.read("nav_command", NavCommand),
    )
    robot.publish("localization", LocalizationEstimate(located=True, health=0.7))
    robot.publish("navigate_goal", mission(1, (1.0, 2.0, 0.5)), qos=LATCHED)
    robot.run_for(0.1)
    command_id = nav_commands.take()[-1].command_id
    robot.publish("plan", Plan(command_id=command_id), qos=LATCHED)
    robot.run_for(0.2)

    robot.publish("motion_status", MotionStatus(command_id=command_id, state=MotionStatus.DONE))

    assert statuses.take()[-1].state == state


def test_changing_numbers_in_a_reason_are_not_published_at_once(make_harness: MakeHarness) -> None:
    robot = make_harness(PLUGINS)
    statuses, nav_commands = (
        robot.read("navigation_status", NavigationStatus),
        robot.read("nav_command", NavCommand),
    )
    robot.publish("localization", LocalizationEstimate(located=True, health=0.9))
    robot.publish("navigate_goal", mission(1, (1.0, 2.0, 0.5)), qos=LATCHED)
    robot.run_for(0.1)
    command_id = nav_commands.take()[-1].command_id
    robot.publish("plan", Plan(command_id=command_id), qos=LATCHED)
    for tenths in range(6, 26):
        reason = f"no scan for {tenths / 10:.1f} s on /robot/scan"
        robot.publish(
            "motion_status",
            MotionStatus(command_id=command_id, state=MotionStatus.STOPPED, reason=reason),
        )
        robot.run_for(0.1)
    assert len(statuses.take()) < 12


def test_new_mission_preempts_and_empty_mission_cancels(make_harness: MakeHarness) -> None:
    robot = make_harness(PLUGINS)
    statuses, nav_commands = (
        robot.read("navigation_status", NavigationStatus),
        robot.read("nav_command", NavCommand),
    )
    robot.publish("navigate_goal", mission(1, (1.0, 2.0, 0.5)), qos=LATCHED)
    robot.publish("navigate_goal", mission(2, (3.0, 4.0, 0.5)), qos=LATCHED)
    robot.publish("navigate_goal", mission(2, (3.0, 4.0, 0.5)), qos=LATCHED)  # repeated
    robot.run_for(0.2)
    assert statuses.take()[-1].mission_id == 2
    command_ids = len({nav_command.command_id for nav_command in nav_commands.take()})

    robot.publish("navigate_goal", mission(1), qos=LATCHED)  # of a mission that has ended: ignored
    robot.run_for(0.2)
    assert statuses.take() == []
    robot.publish("navigate_goal", mission(2), qos=LATCHED)

    last = statuses.take()[-1]
    assert (last.mission_id, last.state) == (2, NavigationStatus.CANCELED)
    stand = nav_commands.take()[-1]
    assert stand.behavior == NavCommand.STAND
    assert command_ids == 2


def test_finished_mission_is_ignored(make_harness: MakeHarness) -> None:
    robot = make_harness(PLUGINS)
    statuses = robot.read("navigation_status", NavigationStatus)
    robot.publish("navigate_goal", mission(9), qos=LATCHED)
    robot.publish("navigate_goal", mission(10, (1.0, 1.0, 0.0), first=1), qos=LATCHED)
    robot.run_for(1.0)
    assert statuses.take() == []
