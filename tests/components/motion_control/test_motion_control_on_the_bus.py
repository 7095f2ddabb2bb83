"""The component on a bus in virtual time, its ports driven by the test."""

import math
from typing import Any

import numpy as np
import pytest

from cairn import SECOND
from cairn.planar.poses import compose, inverse
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, MotionStatus, NavCommand, Plan
from tests.components.motion_control.simulated_drive import SimulatedDrive
from tests.components.motion_control.world import Robot, Wall, World, box
from tests.wording import assert_words

pytestmark = pytest.mark.slow


HALL = box(0, 0, 20, 20)
STATES = MotionStatus


def simulated_drive(*walls: Wall, **parameters: Any) -> SimulatedDrive:
    """A robot that stands at (-3, 0) in a hall with these walls."""
    return SimulatedDrive(World([*HALL, *walls]), Robot((-3.0, 0.0, 0.0)), **parameters)


def follow_path(**parameters: Any) -> SimulatedDrive:
    """A robot driving to (3, 0) at full speed."""
    drive = simulated_drive(**parameters)
    drive.command(7, NavCommand.FOLLOW, (3.0, 0.0, 1.0))
    drive.publish_plan(7, (-3, 0), (3, 0))
    drive.run_for(3.0)
    return drive


def test_plan_is_followed_to_the_goal_and_its_heading() -> None:
    drive = follow_path()
    assert drive.status.state == STATES.MOVING
    assert drive.robot.speed == pytest.approx(0.6, abs=0.01)
    assert drive.status.distance_left == pytest.approx(3 - drive.robot.pose[0], abs=0.2)

    drive.run_for(15, until=STATES.DONE)

    x, y, heading = drive.robot.pose
    assert drive.status.state == STATES.DONE
    assert drive.status.command_id == 7
    assert math.hypot(x - 3, y) < 0.1
    assert heading == pytest.approx(1.0, abs=0.1)


def test_commands_have_at_least_20_hz_and_follow_each_scan() -> None:
    drive = follow_path()

    times = np.array([time for time, _, _ in drive.commands]) / SECOND

    assert np.diff(times).max() < 0.061
    assert 18 < len(times) / (times[-1] - times[0]) < 31


def test_robot_stands_after_the_goal_and_its_state_stays_done() -> None:
    drive = follow_path()
    drive.run_for(15, until=STATES.DONE)
    drive.statuses.clear()
    drive.commands.clear()

    drive.run_for(2)

    assert {status.state for status in drive.statuses} == {STATES.DONE}
    assert {command[1:] for command in drive.commands} == {(0.0, 0.0)}


def test_robot_stands_on_command() -> None:
    drive = follow_path()

    drive.command(8, NavCommand.STAND)
    drive.run_for(1.5)

    assert drive.status.state == STATES.STANDING
    assert drive.status.command_id == 8
    assert drive.robot.speed == 0.0


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
    drive = follow_path()

    drive.muted.add(topic)
    muted_at = drive.now
    drive.run_for(3.0, until=STATES.STOPPED)

    assert drive.status.reason.startswith(reason)
    assert drive.status.reason.endswith(f"on /robot/{topic}")
    assert (drive.now - muted_at) / SECOND < timeout_s + 0.6
    drive.run_for(1.0)
    assert drive.robot.speed == 0.0
    drive.muted.clear()
    drive.run_for(1.0)
    assert drive.status.state == STATES.MOVING
    assert drive.robot.speed > 0.3


def test_log_has_obstructions_and_not_what_every_goal_repeats(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    drive = follow_path()
    caplog.clear()

    drive.muted.add("scan")
    drive.run_for(3.0, until=STATES.STOPPED)
    drive.muted.clear()
    drive.run_for(15, until=STATES.DONE)
    drive.command(8, NavCommand.STAND)
    drive.run_for(1.0)

    stopped, moving = (record.getMessage() for record in caplog.records)
    assert stopped.startswith("stopped: no scan for 0.5")
    assert moving == "moving"


@pytest.mark.parametrize("back_s", [1.0, 600.0])
def test_robot_pauses_after_a_time_reset_and_continues(
    back_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    drive = follow_path(simulated_time=True)

    drive.set_clocks_back(back_s)
    drive.run_for(0.1)

    assert drive.status.state == STATES.STOPPED
    drive.run_for(2.0)
    assert drive.status.state == STATES.MOVING
    assert drive.robot.speed == pytest.approx(0.6, abs=0.05)
    drive.run_for(15, until=STATES.DONE)
    assert math.hypot(drive.robot.pose[0] - 3, drive.robot.pose[1]) < 0.1
    assert caplog.text.count(f"odometry on /robot/odom went back in time by {back_s:.1f} s") == 1


@pytest.mark.parametrize("topic", ["scan", "odom", "nav_command", "localization"])
def test_input_that_ends_at_a_time_reset_is_stale_at_once(topic: str) -> None:
    drive = follow_path(simulated_time=True)

    drive.muted.add(topic)
    drive.set_clocks_back(600.0)
    drive.run_for(1.5)

    assert drive.status.state == STATES.STOPPED
    assert_words(drive.status.reason, "no", topic, "time", f"/robot/{topic}")
    assert drive.robot.speed == 0.0
    drive.commands.clear()
    drive.run_for(1.0)
    assert {command[1:] for command in drive.commands} == {(0.0, 0.0)}
    assert len(drive.commands) >= 15


def test_input_that_never_arrived_is_named() -> None:
    drive = simulated_drive()
    drive.muted.add("scan")

    drive.command(1, NavCommand.LOOK_AROUND)
    drive.run_for(0.5)

    assert drive.status.state == STATES.STOPPED
    assert_words(drive.status.reason, "no scan yet", "/robot/scan")


def test_only_a_plan_of_the_same_goal_is_followed() -> None:
    drive = follow_path()

    drive.command(8, NavCommand.FOLLOW, (3.0, 3.0, 0.0))
    drive.run_for(2.0)

    assert drive.status.state == STATES.BLOCKED
    assert_words(drive.status.reason, "no plan", "goal", "/robot/plan")
    assert drive.robot.speed == 0.0
    drive.publish_plan(8, (drive.robot.pose[0], 0.0), (3.0, 3.0))
    drive.run_for(20, until=STATES.DONE)
    assert math.hypot(drive.robot.pose[0] - 3, drive.robot.pose[1] - 3) < 0.1


def test_plan_of_another_goal_does_not_interfere() -> None:
    drive = follow_path()

    drive.publish_plan(8, (0, 0), (0, 3))
    drive.run_for(0.5)

    assert drive.status.state == STATES.MOVING
    assert drive.robot.speed == pytest.approx(0.6, abs=0.01)


def test_reason_of_a_missing_path_is_reported() -> None:
    drive = simulated_drive()

    drive.command(1, NavCommand.FOLLOW)
    drive.publish_plan(1, outcome=Plan.UNREACHABLE, reason="no way through the door")
    drive.run_for(0.5)

    assert drive.status.state == STATES.BLOCKED
    assert_words(drive.status.reason, "no path", "no way through the door")


def test_path_is_replaced_while_driving() -> None:
    drive = follow_path()

    drive.publish_plan(7, (drive.robot.pose[0], 0), (0, 1), (3, 0))
    drive.run_for(20, until=STATES.DONE)

    assert max(abs(command[2]) for command in drive.commands) > 0.2
    assert math.hypot(drive.robot.pose[0] - 3, drive.robot.pose[1]) < 0.1


def test_goal_at_the_robots_pose_needs_no_motion() -> None:
    drive = simulated_drive()

    drive.command(1, NavCommand.FOLLOW, (-3.0, 0.0, 2.0))
    drive.publish_plan(1)
    drive.run_for(10, until=STATES.DONE)

    assert drive.robot.pose[2] == pytest.approx(2.0, abs=0.1)
    assert math.hypot(drive.robot.pose[0] + 3, drive.robot.pose[1]) < 0.05


def test_lost_robot_stands_until_it_is_located() -> None:
    drive = follow_path()

    drive.localization = LocalizationEstimate(
        located=True, health=0.1, reason="the scan does not fit"
    )
    drive.run_for(1.5)

    assert drive.status.state == STATES.STOPPED
    assert_words(drive.status.reason, "lost", "0.10", "the scan does not fit")
    assert drive.robot.speed == 0.0
    drive.localization = LocalizationEstimate(located=True, health=0.8)
    drive.run_for(1.0)
    assert drive.status.state == STATES.MOVING


@pytest.mark.parametrize(
    "behavior", [NavCommand.BACK_OFF, NavCommand.LOOK_AROUND, NavCommand.EXPLORE]
)
def test_recovery_motions_need_no_pose(behavior: int) -> None:
    drive = simulated_drive()
    drive.muted.add("localization")

    drive.command(3, behavior, distance=2.5)
    drive.run_for(20, until=STATES.DONE)

    assert drive.status.state == STATES.DONE
    x, y, _ = drive.robot.pose
    gone = math.hypot(x + 3, y)
    expected = {NavCommand.BACK_OFF: 0.3, NavCommand.LOOK_AROUND: 0.0, NavCommand.EXPLORE: 2.5}
    assert gone == pytest.approx(expected[behavior], abs=0.15)


def test_odometry_jump_is_reported_and_the_robot_pauses(
    caplog: pytest.LogCaptureFixture,
) -> None:
    drive = follow_path()

    x, y, heading = drive.robot.odom
    drive.robot.odom = (x + 1.2, y, heading)
    drive.run_for(0.2)

    assert drive.status.state == STATES.STOPPED
    assert drive.status.reason.startswith("odometry on /robot/odom jumped by 1.2")
    assert "jumped by 1.2" in caplog.text
    drive.run_for(15, until=STATES.DONE)
    assert math.hypot(drive.robot.pose[0] - 3, drive.robot.pose[1]) < 0.1


def test_path_is_followed_with_odometry_that_is_late_and_out_of_order(
    caplog: pytest.LogCaptureFixture,
) -> None:
    drive = simulated_drive((-1.0, 0.35, 1.0, 0.35), (-1.0, -0.35, 1.0, -0.35))
    drive.odometry_delay_s, drive.odometry_loss = (0.0, 0.3), 0.02
    drive.command(7, NavCommand.FOLLOW, (3.0, 0.0, 1.0))
    drive.publish_plan(7, (-3, 0), (3, 0))

    drive.run_for(40, until=STATES.DONE)

    assert drive.status.state == STATES.DONE
    assert math.hypot(drive.robot.pose[0] - 3, drive.robot.pose[1]) < 0.1
    assert drive.clearance > 0.05
    assert "odometry on" not in caplog.text


def test_scans_are_placed_where_they_were_taken_although_odometry_is_late() -> None:
    square = box(-3, 0, 3.0, 3.0)
    drive = SimulatedDrive(World(square), Robot((-3.0, 0.0, 0.0)))
    drive.odometry_delay_s = (0.25, 0.25)
    drive.command(3, NavCommand.LOOK_AROUND)

    drive.run_for(0.7)  # it accelerates

    memory = drive.motion_control.component._memory
    points = memory.points
    origin = compose(drive.robot.pose, inverse(drive.robot.odom))
    x, y = np.array([compose(origin, (px, py, 0.0))[:2] for px, py in points.tolist()]).T
    errors = np.abs(np.maximum(np.abs(x + 3.0), np.abs(y)) - 1.5)
    assert drive.robot.turn != 0.0
    assert points.shape[0] > 300
    assert np.quantile(errors, 0.95) < 0.05


def test_obstacle_on_the_path_is_reported() -> None:
    drive = simulated_drive((0.0, -10.0, 0.0, 10.0))

    drive.command(1, NavCommand.FOLLOW, (3.0, 0.0, 0.0))
    drive.publish_plan(1, (-3, 0), (3, 0))
    drive.run_for(10, until=STATES.BLOCKED)

    assert "ahead on the path" in drive.status.reason
    assert drive.status.clearance == pytest.approx(drive.clearance, abs=0.03)
    assert drive.clearance > 0.05


def test_changed_speed_applies_while_driving() -> None:
    drive = follow_path()

    drive.motion_control.set_parameters({"speed": 0.3})
    drive.run_for(2.0)

    assert drive.robot.speed == pytest.approx(0.3, abs=0.01)
    assert drive.status.state == STATES.MOVING


def test_largest_robot_drives_in_open_space() -> None:
    drive = follow_path(radius=1.0)

    assert drive.status.state == STATES.MOVING
    drive.run_for(15, until=STATES.DONE)
    assert math.hypot(drive.robot.pose[0] - 3, drive.robot.pose[1]) < 0.1


def test_deactivation_stops_the_robot() -> None:
    drive = follow_path()

    drive.motion_control.request("deactivate")
    drive.run_for(1.5)

    assert drive.robot.speed == 0.0


def test_rotated_scanner_is_supported() -> None:
    drive = simulated_drive((0.0, -10.0, 0.0, 10.0), mount={"x": 0.1, "theta": math.pi / 2})
    drive.mount = (0.1, 0.0, math.pi / 2)

    drive.command(1, NavCommand.FOLLOW, (3.0, 0.0, 0.0))
    drive.publish_plan(1, (-3, 0), (3, 0))
    drive.run_for(10, until=STATES.BLOCKED)

    assert drive.robot.pose[0] == pytest.approx(-0.4, abs=0.06)


def test_number_of_beams_may_change() -> None:
    drive = follow_path()

    drive.beams = 90
    drive.run_for(15, until=STATES.DONE)

    assert drive.status.state == STATES.DONE


def test_runs_are_reproducible() -> None:
    first, second = follow_path(), follow_path()

    assert first.commands == second.commands
    assert first.statuses == second.statuses
