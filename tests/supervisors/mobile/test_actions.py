"""Nav2's actions drive the simulated robot; goals survive a restart of the supervisor."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from cairn.bus.actions import SentGoal
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import distance
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.builtin_interfaces import Duration
from cairn.schemas.geometry_msgs import Point, PoseStamped
from cairn.schemas.nav2_msgs.action import (
    BackUp,
    FollowWaypoints,
    NavigateThroughPoses,
    NavigateToPose,
    Spin,
)
from cairn.schemas.std_msgs import Header
from tests.navigation.conftest import drive  # noqa: F401 - a fixture
from tests.navigation.driving import LockstepRobot
from tests.sweeps import sampled
from tests.wording import assert_words

SUCCEEDED, CANCELED, ABORTED = (
    GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED,
)  # fmt: skip


def pose(x: float, y: float, theta: float = 0.0, frame: str = "map") -> PoseStamped:
    return PoseStamped(header=Header(frame_id=frame), pose=pose_message((x, y, theta)))


@pytest.fixture
def robot(drive: Callable[..., LockstepRobot]) -> LockstepRobot:  # noqa: F811
    robot = drive()
    robot.run_for(4.0)
    return robot


def to_pose(
    robot: LockstepRobot, x: float, y: float, frame: str = "map"
) -> SentGoal[Any, Any, Any]:
    goal = NavigateToPose.Goal(pose=pose(x, y, frame=frame))
    return robot.send_goal("navigate_to_pose", NavigateToPose, goal)


def end(robot: LockstepRobot, sent: SentGoal[Any, Any, Any]) -> tuple[int | None, Any]:
    robot.run_until(lambda: sent.has_ended)
    assert sent.error is None
    return sent.status, sent.result


def test_goal_is_reached_with_feedback_on_the_way(robot: LockstepRobot) -> None:
    sent = to_pose(robot, 2.4, 1.2)
    status, result = end(robot, sent)

    assert (status, result) == (SUCCEEDED, NavigateToPose.Result())
    left = [one.distance_remaining for one in sent.feedback]
    assert left[3] > 1.0 > left[-1]
    assert sent.feedback[-1].navigation_time.sec >= 2
    assert distance(planar_pose(sent.feedback[-1].current_pose.pose), (2.4, 1.2, 0.0)) < 0.5


def test_goal_is_canceled_and_the_next_preempts(robot: LockstepRobot) -> None:
    first = to_pose(robot, 7.5, 5.0)
    robot.run_for(2.0)
    first.cancel()
    assert end(robot, first) == (CANCELED, NavigateToPose.Result(error_msg="on request"))

    second = to_pose(robot, 7.5, 5.0)
    robot.run_for(2.0)
    third = to_pose(robot, 2.4, 1.2)
    status, result = end(robot, second)
    assert status == ABORTED
    assert_words(result.error_msg, "preempted by mission")
    assert end(robot, third)[0] == SUCCEEDED


@pytest.mark.parametrize(
    ("position", "frame", "code", "words"),
    sampled(
        [
            ((100.0, 1.0), "map", 204, "outside the map"),
            ((4.0, 3.0), "odom", 9002, "frame odom, not map"),
            ((1e9, 0.0), "map", 9000, "must be finite, and at most"),
        ]
    ),
)
def test_impossible_goal_is_aborted_with_nav2s_error_code(
    robot: LockstepRobot, position: tuple[float, float], frame: str, code: int, words: str
) -> None:
    status, result = end(robot, to_pose(robot, *position, frame))
    assert (status, result.error_code) == (ABORTED, code)
    assert words in result.error_msg


@pytest.mark.accuracy
def test_several_poses_are_driven_through(robot: LockstepRobot) -> None:
    poses = (pose(2.4, 1.2), pose(3.0, 1.2))
    goal = NavigateThroughPoses.Goal(poses=poses)
    sent = robot.send_goal("navigate_through_poses", NavigateThroughPoses, goal)
    assert end(robot, sent)[0] == SUCCEEDED
    left = [one.number_of_poses_remaining for one in sent.feedback]
    assert (max(left), min(left)) == (2, 1)

    none = robot.send_goal("navigate_through_poses", NavigateThroughPoses,
                           NavigateThroughPoses.Goal())  # fmt: skip
    assert end(robot, none)[1].error_msg == "the goal has 0 poses, and begins with pose 1"


@pytest.mark.accuracy
def test_waypoints_are_followed_in_rounds(robot: LockstepRobot) -> None:
    goal = FollowWaypoints.Goal(poses=(pose(2.0, 1.2), pose(2.6, 1.2)), number_of_loops=1)
    sent = robot.send_goal("follow_waypoints", FollowWaypoints, goal)
    assert end(robot, sent) == (SUCCEEDED, FollowWaypoints.Result())
    visited = [one.current_waypoint for one in sent.feedback]
    changes = [one for one, before in zip(visited, [-1, *visited], strict=False) if one != before]
    assert changes == [0, 1, 0, 1]


@pytest.mark.accuracy
def test_waypoint_that_is_not_reached_ends_the_goal_or_is_listed(
    drive: Callable[..., LockstepRobot],  # noqa: F811
) -> None:
    goal = FollowWaypoints.Goal(poses=(pose(2.0, 1.2), pose(99.0, 1.2), pose(2.6, 1.2)))
    robot = drive()
    status, result = end(robot, robot.send_goal("follow_waypoints", FollowWaypoints, goal))
    assert (status, result.error_code) == (ABORTED, 204)
    assert [(one.index, one.error_code) for one in result.missed_waypoints] == [(1, 204)]

    robot = drive("components.mobile_supervisor.parameters.stop_on_failure=false")
    status, result = end(robot, robot.send_goal("follow_waypoints", FollowWaypoints, goal))
    assert status == SUCCEEDED
    assert [(one.index, one.goal.pose.position.x) for one in result.missed_waypoints] == [(1, 99.0)]
    assert robot.truth[0] == pytest.approx(2.6, abs=0.2)


@pytest.mark.parametrize("angle", sampled([-1.0, math.pi / 2]))
def test_robot_spins(robot: LockstepRobot, angle: float) -> None:
    heading = robot.truth[2]
    sent = robot.send_goal("spin", Spin, Spin.Goal(target_yaw=angle))
    status, result = end(robot, sent)
    assert (status, result.error_code) == (SUCCEEDED, 0)
    robot.run_for(1.0)
    assert robot.truth[2] - heading == pytest.approx(angle, abs=0.1)
    assert sent.feedback[-1].angular_distance_traveled == pytest.approx(abs(angle), abs=0.6)


@pytest.mark.accuracy
def test_spin_ends_with_its_time(robot: LockstepRobot) -> None:
    goal = Spin.Goal(target_yaw=20.0, time_allowance=Duration(sec=2))
    status, result = end(robot, robot.send_goal("spin", Spin, goal))
    assert (status, result.error_code) == (ABORTED, Spin.Result.TIMEOUT)
    assert result.total_elapsed_time.sec == 2


@pytest.mark.parametrize(
    ("action", "kind", "goal"),
    [
        ("spin", Spin, Spin.Goal(target_yaw=math.nan)),
        ("spin", Spin, Spin.Goal(target_yaw=-1e30)),
        ("back_up", BackUp, BackUp.Goal(target=Point(x=1e200))),
        ("back_up", BackUp, BackUp.Goal(target=Point(x=-0.3), speed=math.inf)),
    ],
)
def test_impossible_motion_is_rejected_and_the_mission_continues(
    drive: Callable[..., LockstepRobot],  # noqa: F811
    action: str,
    kind: Any,
    goal: Any,
) -> None:
    robot = drive()
    sent = to_pose(robot, 2.4, 1.2)
    rejected = robot.send_goal(action, kind, goal)
    robot.run_for(0.5)
    assert rejected.error is not None
    assert not sent.has_ended


@pytest.mark.accuracy
def test_robot_backs_up_where_it_has_driven_and_not_where_it_sees_nothing(
    robot: LockstepRobot,
) -> None:
    blind = robot.send_goal("back_up", BackUp, BackUp.Goal(target=Point(x=-0.3), speed=0.1))
    status, result = end(robot, blind)
    assert (status, result.error_code) == (ABORTED, BackUp.Result.COLLISION_AHEAD)
    assert_words(result.error_msg, "does not move", "velocity gate")

    assert end(robot, to_pose(robot, 3.0, 1.2))[0] == SUCCEEDED
    x = robot.truth[0]
    # The velocity gate forgets after 4 s what the scanner saw: faster than that.
    sent = robot.send_goal("back_up", BackUp, BackUp.Goal(target=Point(x=-0.3), speed=0.2))
    assert end(robot, sent)[0] == SUCCEEDED
    robot.run_for(0.5)
    assert x - robot.truth[0] == pytest.approx(0.3, abs=0.06)
