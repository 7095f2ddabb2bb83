"""The component on a bus in virtual time, its ports driven by the test."""

import math
from typing import Any

import numpy as np
import pytest

from cairn import SECOND
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, MotionStatus, NavCommand, Plan
from tests.components.motion_control.stage import Stage
from tests.components.motion_control.world import Robot, World, box

pytestmark = pytest.mark.slow


HALL = box(0, 0, 20, 20)
STATES = MotionStatus


def stage(*walls: tuple[float, float, float, float], **parameters: Any) -> Stage:
    return Stage(World([*HALL, *walls]), Robot((-3.0, 0.0, 0.0)), **parameters)


def following(**parameters: Any) -> Stage:
    """A robot driving to (3, 0) at full speed."""
    it = stage(**parameters)
    it.want(7, NavCommand.FOLLOW, (3.0, 0.0, 1.0))
    it.plan(7, (-3, 0), (3, 0))
    it.wait(3.0)
    return it


def test_plan_is_followed_to_the_goal_and_its_heading() -> None:
    it = following()
    assert it.status.state == STATES.MOVING
    assert it.robot.speed == pytest.approx(0.6, abs=0.01)
    assert it.status.distance_left == pytest.approx(3 - it.robot.pose[0], abs=0.2)

    it.wait(15, until=STATES.DONE)

    x, y, heading = it.robot.pose
    assert it.status.state == STATES.DONE
    assert it.status.goal_id == 7
    assert math.hypot(x - 3, y) < 0.1
    assert heading == pytest.approx(1.0, abs=0.1)


def test_commands_have_at_least_20_hz_and_follow_each_scan() -> None:
    it = following()

    times = np.array([time for time, _, _ in it.commands]) / SECOND

    assert np.diff(times).max() < 0.061
    assert 18 < len(times) / (times[-1] - times[0]) < 31


def test_robot_stays_done_and_stands_after_the_goal() -> None:
    it = following()
    it.wait(15, until=STATES.DONE)
    it.statuses.clear()
    it.commands.clear()

    it.wait(2)

    assert {status.state for status in it.statuses} == {STATES.DONE}
    assert {command[1:] for command in it.commands} == {(0.0, 0.0)}


def test_robot_stands_on_command() -> None:
    it = following()

    it.want(8, NavCommand.STAND)
    it.wait(1.5)

    assert it.status.state == STATES.STANDING
    assert it.status.goal_id == 8
    assert it.robot.speed == 0.0


@pytest.mark.parametrize(
    ("topic", "timeout_s", "reason"),
    [
        ("scan", 0.5, "no scan for 0.5"),
        ("odom", 0.3, "no odom for 0.3"),
        ("nav_command", 1.5, "no nav_command for 1.5"),
        ("localization", 1.0, "no localization for 1.0"),
    ],
)
def test_stale_input_stops_the_robot_and_is_named(
    topic: str, timeout_s: float, reason: str
) -> None:
    it = following()

    it.muted.add(topic)
    muted_at = it.now
    it.wait(3.0, until=STATES.STOPPED)

    assert it.status.reason.startswith(reason)
    assert it.status.reason.endswith(f"on /robot/{topic}")
    assert (it.now - muted_at) / SECOND < timeout_s + 0.6
    it.wait(1.0)
    assert it.robot.speed == 0.0
    it.muted.clear()
    it.wait(1.0)
    assert it.status.state == STATES.MOVING
    assert it.robot.speed > 0.3


@pytest.mark.parametrize("back_s", [1.0, 600.0])
def test_robot_pauses_after_a_time_reset_and_continues(
    back_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    it = following(simulated_time=True)

    it.set_back(back_s)
    it.wait(0.1)

    assert it.status.state == STATES.STOPPED
    it.wait(2.0)
    assert it.status.state == STATES.MOVING
    assert it.robot.speed == pytest.approx(0.6, abs=0.05)
    it.wait(15, until=STATES.DONE)
    assert math.hypot(it.robot.pose[0] - 3, it.robot.pose[1]) < 0.1
    assert caplog.text.count(f"odometry on /robot/odom went back in time by {back_s:.1f} s") == 1


@pytest.mark.parametrize("topic", ["scan", "odom", "nav_command", "localization"])
def test_input_that_ends_at_a_time_reset_is_stale_at_once(topic: str) -> None:
    it = following(simulated_time=True)

    it.muted.add(topic)
    it.set_back(600.0)
    it.wait(1.5)

    assert it.status.state == STATES.STOPPED
    assert it.status.reason == f"no {topic} since time was set back on /robot/{topic}"
    assert it.robot.speed == 0.0
    it.commands.clear()
    it.wait(1.0)
    assert {command[1:] for command in it.commands} == {(0.0, 0.0)}
    assert len(it.commands) >= 15


def test_input_that_never_arrived_is_named() -> None:
    it = stage()
    it.muted.add("scan")

    it.want(1, NavCommand.LOOK_AROUND)
    it.wait(0.5)

    assert it.status.state == STATES.STOPPED
    assert it.status.reason == "no scan yet on /robot/scan"


def test_only_a_plan_of_the_same_goal_counts() -> None:
    it = following()

    it.want(8, NavCommand.FOLLOW, (3.0, 3.0, 0.0))
    it.wait(2.0)

    assert it.status.state == STATES.BLOCKED
    assert it.status.reason == "no plan of this goal yet on /robot/plan"
    assert it.robot.speed == 0.0
    it.plan(8, (it.robot.pose[0], 0.0), (3.0, 3.0))
    it.wait(20, until=STATES.DONE)
    assert math.hypot(it.robot.pose[0] - 3, it.robot.pose[1] - 3) < 0.1


def test_plan_of_another_goal_does_not_interfere() -> None:
    it = following()

    it.plan(8, (0, 0), (0, 3))
    it.wait(0.5)

    assert it.status.state == STATES.MOVING
    assert it.robot.speed == pytest.approx(0.6, abs=0.01)


def test_reason_of_a_missing_path_is_reported() -> None:
    it = stage()

    it.want(1, NavCommand.FOLLOW)
    it.plan(1, outcome=Plan.UNREACHABLE, reason="no way through the door")
    it.wait(0.5)

    assert it.status.state == STATES.BLOCKED
    assert it.status.reason == "there is no path: no way through the door"


def test_path_is_replaced_while_driving() -> None:
    it = following()

    it.plan(7, (it.robot.pose[0], 0), (0, 1), (3, 0))
    it.wait(20, until=STATES.DONE)

    assert max(abs(command[2]) for command in it.commands) > 0.2
    assert math.hypot(it.robot.pose[0] - 3, it.robot.pose[1]) < 0.1


def test_goal_at_the_robots_pose_needs_no_motion() -> None:
    it = stage()

    it.want(1, NavCommand.FOLLOW, (-3.0, 0.0, 2.0))
    it.plan(1)
    it.wait(10, until=STATES.DONE)

    assert it.robot.pose[2] == pytest.approx(2.0, abs=0.1)
    assert math.hypot(it.robot.pose[0] + 3, it.robot.pose[1]) < 0.05


def test_lost_robot_stands_until_it_is_located() -> None:
    it = following()

    it.health = LocalizationEstimate(located=True, health=0.1, reason="the scan does not fit")
    it.wait(1.5)

    assert it.status.state == STATES.STOPPED
    assert it.status.reason == "the robot is lost, health 0.10: the scan does not fit"
    assert it.robot.speed == 0.0
    it.health = LocalizationEstimate(located=True, health=0.8)
    it.wait(1.0)
    assert it.status.state == STATES.MOVING


@pytest.mark.parametrize(
    "behavior", [NavCommand.BACK_OFF, NavCommand.LOOK_AROUND, NavCommand.EXPLORE]
)
def test_recovery_motions_need_no_pose(behavior: int) -> None:
    it = stage()
    it.muted.add("localization")

    it.want(3, behavior, distance=2.5)
    it.wait(20, until=STATES.DONE)

    assert it.status.state == STATES.DONE
    x, y, _ = it.robot.pose
    gone = math.hypot(x + 3, y)
    expected = {NavCommand.BACK_OFF: 0.3, NavCommand.LOOK_AROUND: 0.0, NavCommand.EXPLORE: 2.5}
    assert gone == pytest.approx(expected[behavior], abs=0.15)


def test_odometry_jump_is_reported_and_the_robot_pauses(
    caplog: pytest.LogCaptureFixture,
) -> None:
    it = following()

    x, y, heading = it.robot.odom
    it.robot.odom = (x + 1.2, y, heading)
    it.wait(0.2)

    assert it.status.state == STATES.STOPPED
    assert it.status.reason.startswith("odometry on /robot/odom jumped by 1.2")
    assert "jumped by 1.2" in caplog.text
    it.wait(15, until=STATES.DONE)
    assert math.hypot(it.robot.pose[0] - 3, it.robot.pose[1]) < 0.1


def test_obstacle_on_the_path_is_reported() -> None:
    it = stage((0.0, -10.0, 0.0, 10.0))

    it.want(1, NavCommand.FOLLOW, (3.0, 0.0, 0.0))
    it.plan(1, (-3, 0), (3, 0))
    it.wait(10, until=STATES.BLOCKED)

    assert "ahead on the path" in it.status.reason
    assert it.status.clearance == pytest.approx(it.clearance, abs=0.03)
    assert it.clearance > 0.05


def test_changed_speed_applies_while_driving() -> None:
    it = following()

    it.part.ask("set_parameters", speed=0.3)
    it.wait(2.0)

    assert it.robot.speed == pytest.approx(0.3, abs=0.01)
    assert it.status.state == STATES.MOVING


def test_largest_robot_drives_in_open_space() -> None:
    it = following(radius=1.0)

    assert it.status.state == STATES.MOVING
    it.wait(15, until=STATES.DONE)
    assert math.hypot(it.robot.pose[0] - 3, it.robot.pose[1]) < 0.1


def test_deactivation_stops_the_robot() -> None:
    it = following()

    it.part.ask("deactivate")
    it.wait(1.5)

    assert it.robot.speed == 0.0


def test_rotated_scanner_is_supported() -> None:
    it = stage((0.0, -10.0, 0.0, 10.0), mount={"x": 0.1, "theta": math.pi / 2})
    it.mount = (0.1, 0.0, math.pi / 2)

    it.want(1, NavCommand.FOLLOW, (3.0, 0.0, 0.0))
    it.plan(1, (-3, 0), (3, 0))
    it.wait(10, until=STATES.BLOCKED)

    assert it.robot.pose[0] == pytest.approx(-0.4, abs=0.06)


def test_number_of_beams_may_change() -> None:
    it = following()

    it.beams = 90
    it.wait(15, until=STATES.DONE)

    assert it.status.state == STATES.DONE


def test_runs_are_reproducible() -> None:
    first, second = following(), following()

    assert first.commands == second.commands
    assert first.statuses == second.statuses
