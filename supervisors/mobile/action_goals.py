"""Missions as ROS 2 actions of Nav2: what a goal asks for, its feedback and its result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Final

from cairn import SECOND, CairnError, ServerGoal
from cairn.planar.messages import duration_message, pose_in_map, pose_message
from cairn.planar.poses import Pose
from cairn.schemas.builtin_interfaces import Duration
from cairn.schemas.cairn_nav_msgs import (
    MAX_GOALS,
    MAX_MOTION,
    NavigateGoal,
    NavigationStatus,
    ReasonCode,
)
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.nav2_msgs.action import (
    BackUp,
    ComputePathToPose,
    FollowPath,
    FollowWaypoints,
    NavigateThroughPoses,
    NavigateToPose,
    Spin,
)
from cairn.schemas.nav2_msgs.msg import MissedWaypoint
from cairn.schemas.std_msgs import Header
from cairn.supervisors.mobile.mission_file import ActionRecord

UNKNOWN_ERROR: Final = 9000
"""Any other error, as Nav2's navigators number it from Kilted on."""

FRAME_ERROR: Final = 9002
"""Nav2's error TF_ERROR: where the robot or its goal is in frame map is not known."""

TIMEOUT_ERROR: Final = 9003
"""Nav2's error TIMEOUT."""

_ERROR_CODES: Final = {
    ReasonCode.NOT_LOCATED: FRAME_ERROR,
    ReasonCode.NO_LOCALIZATION: FRAME_ERROR,
    ReasonCode.POSITION_UNCERTAIN: FRAME_ERROR,
    ReasonCode.HEADING_UNCERTAIN: FRAME_ERROR,
    ReasonCode.GOAL_OUTSIDE_MAP: ComputePathToPose.Result.GOAL_OUTSIDE_MAP,
    ReasonCode.START_BLOCKED: ComputePathToPose.Result.START_OCCUPIED,
    ReasonCode.IN_KEEPOUT: ComputePathToPose.Result.START_OCCUPIED,
    ReasonCode.GOAL_BLOCKED: ComputePathToPose.Result.GOAL_OCCUPIED,
    ReasonCode.GOAL_IN_KEEPOUT: ComputePathToPose.Result.GOAL_OCCUPIED,
    ReasonCode.GOAL_UNREACHABLE: ComputePathToPose.Result.NO_VALID_PATH,
    ReasonCode.NO_PLAN: ComputePathToPose.Result.NO_VALID_PATH,
    ReasonCode.PLANNER_NOT_READY: ComputePathToPose.Result.TIMEOUT,
    ReasonCode.NO_PROGRESS: FollowPath.Result.FAILED_TO_MAKE_PROGRESS,
    ReasonCode.OBSTACLE: FollowPath.Result.FAILED_TO_MAKE_PROGRESS,
    ReasonCode.OFF_PATH: FollowPath.Result.NO_VALID_CONTROL,
    ReasonCode.TIMED_OUT: TIMEOUT_ERROR,
    ReasonCode.NO_MOTION_STATUS: FollowPath.Result.CONTROLLER_TIMED_OUT,
}
"""The error codes of Nav2 with the same meaning: its navigators pass on those of their servers."""

_LONGEST_M: Final = 1e9
"""Longest distance in feedback [m]."""
_KNOWN: Final = frozenset(map(int, ReasonCode))


def error_code(reason: int) -> int:
    """Return Nav2's error code for the number of a `ReasonCode`, of this version or another."""
    known = _ERROR_CODES.get(ReasonCode(reason)) if reason in _KNOWN else None
    return UNKNOWN_ERROR if known is None else known


class ActionGoal:
    """A goal of one of the actions that missions carry out."""

    action: ClassVar[str]
    """Name of the action's port."""
    messages: ClassVar[Any]
    """The action's messages."""

    def __init__(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """`goal` is that of the action server, which this answers."""
        self.goal = goal
        self.first = 0
        """Index of the pose to which the robot drives first."""

    @property
    def poses(self) -> Sequence[PoseStamped]:
        """Where the robot shall drive, one pose after the other."""
        raise NotImplementedError

    def feedback(self, status: NavigationStatus, pose: PoseStamped) -> Any:
        """Return the feedback for the progress of the mission, with the robot's pose."""
        raise NotImplementedError

    def result(self, code: int, text: str) -> Any:
        """Return the result with an error code and a text, 0 and "" after success."""
        return self.messages.Result(error_code=code, error_msg=text)

    def goes_on(self, _failed: int | None, _code: int) -> bool:
        """Return whether the robot shall drive on, from pose `first`.

        Given: the index of the pose that it could not reach, with the error code; None if it
        has reached all.
        """
        return False

    def record(self) -> ActionRecord:
        """Return what is kept of it on disk."""
        return ActionRecord(name=self.action, goal_id=self.goal.id.hex())


class ToPose(ActionGoal):
    """`navigate_to_pose`: drive to one pose."""

    action = "navigate_to_pose"
    messages = NavigateToPose

    @property
    def poses(self) -> Sequence[PoseStamped]:
        """The pose."""
        return (self.goal.goal.pose,)

    def feedback(self, status: NavigationStatus, pose: PoseStamped) -> NavigateToPose.Feedback:
        """Return the feedback for the progress of the mission."""
        return NavigateToPose.Feedback(**_common(status, pose))


class ThroughPoses(ActionGoal):
    """`navigate_through_poses`: drive to one pose after the other, and fail if one fails."""

    action = "navigate_through_poses"
    messages = NavigateThroughPoses

    @property
    def poses(self) -> Sequence[PoseStamped]:
        """The poses."""
        poses: Sequence[PoseStamped] = self.goal.goal.poses
        return poses

    def feedback(
        self, status: NavigationStatus, pose: PoseStamped
    ) -> NavigateThroughPoses.Feedback:
        """Return the feedback for the progress of the mission."""
        left = max(0, status.goals - status.goal)
        return NavigateThroughPoses.Feedback(
            **_common(status, pose), number_of_poses_remaining=left
        )


class Waypoints(ActionGoal):
    """`follow_waypoints`: drive to the poses, several times if the goal says so.

    Without `stop_on_failure` the robot drives on after a waypoint that it cannot reach, and the
    result lists those.
    """

    action = "follow_waypoints"
    messages = FollowWaypoints

    def __init__(self, goal: ServerGoal[Any, Any, Any], *, stop_on_failure: bool) -> None:
        """Begin at the goal's first waypoint."""
        super().__init__(goal)
        self.first = int(goal.goal.goal_index)
        self.rounds_left = int(goal.goal.number_of_loops)
        self.missed: list[tuple[int, int]] = []
        """The waypoints that were not reached, with their error codes."""
        self._stop_on_failure = stop_on_failure

    @property
    def poses(self) -> Sequence[PoseStamped]:
        """The waypoints."""
        poses: Sequence[PoseStamped] = self.goal.goal.poses
        return poses

    def feedback(self, status: NavigationStatus, _: PoseStamped) -> FollowWaypoints.Feedback:
        """Return the index of the waypoint to which the robot drives."""
        return FollowWaypoints.Feedback(current_waypoint=min(status.goal, len(self.poses) - 1))

    def result(self, code: int, text: str) -> FollowWaypoints.Result:
        """Return the result, with the waypoints that the robot did not reach."""
        missed = tuple(
            MissedWaypoint(index=index, goal=self.poses[index], error_code=why)
            for index, why in self.missed
        )
        return FollowWaypoints.Result(missed_waypoints=missed, error_code=code, error_msg=text)

    def goes_on(self, failed: int | None, code: int) -> bool:
        """Go on to the next waypoint or round; note a waypoint that was not reached."""
        following = len(self.poses)
        if failed is not None:
            failed = min(failed, following - 1)
            self.missed.append((failed, code))
            if self._stop_on_failure or len(self.missed) >= MAX_GOALS:
                return False
            following = failed + 1
        if following >= len(self.poses):
            if self.rounds_left == 0:
                return False
            self.rounds_left -= 1
            following = 0
        self.first = following
        return True

    def record(self) -> ActionRecord:
        """Return what is kept of it on disk."""
        update = {"rounds_left": self.rounds_left, "missed": tuple(self.missed)}
        return super().record().model_copy(update=update)


class MotionGoal(ActionGoal):
    """A goal of one motion: `spin` or `back_up`."""

    motion: ClassVar[int]
    """What to do, as `NavigateGoal.motion`."""

    def __init__(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Raises `CairnError` if the robot cannot move like this."""
        super().__init__(goal)
        self.elapsed = Duration()
        allowed = goal.goal.time_allowance
        self.time_allowance = max(0.0, allowed.sec + allowed.nanosec / SECOND)
        if not abs(self.amount) <= MAX_MOTION:
            raise CairnError(f"cannot {self.action} by {self.amount:g}: at most {MAX_MOTION:g}")
        if not math.isfinite(self.speed):
            raise CairnError(f"cannot {self.action} at {self.speed:g} m/s")

    @property
    def poses(self) -> Sequence[PoseStamped]:
        """There are none."""
        return ()

    @property
    def amount(self) -> float:
        """How much: [rad] to the left, or [m] back."""
        raise NotImplementedError

    @property
    def speed(self) -> float:
        """The highest speed; 0: as usual."""
        return 0.0

    def moved(self, status: NavigationStatus) -> float:
        """Return how much is done; note the time that it took."""
        self.elapsed = duration_message(status.elapsed)
        return max(0.0, abs(self.amount) - status.distance_left)

    def result(self, code: int, text: str) -> Any:
        """Return the result, with the time that it took."""
        result = self.messages.Result
        if code == TIMEOUT_ERROR:
            code = result.TIMEOUT
        elif code == FollowPath.Result.FAILED_TO_MAKE_PROGRESS:
            code = result.COLLISION_AHEAD
        elif code != 0:
            code = result.UNKNOWN
        return result(total_elapsed_time=self.elapsed, error_code=code, error_msg=text)


class SpinGoal(MotionGoal):
    """`spin`: turn on the spot."""

    action = "spin"
    messages = Spin
    motion = NavigateGoal.TURN

    @property
    def amount(self) -> float:
        """How far to turn [rad], to the left if it is positive."""
        return float(self.goal.goal.target_yaw)

    def feedback(self, status: NavigationStatus, _: PoseStamped) -> Spin.Feedback:
        """Return how far the robot has turned."""
        return Spin.Feedback(angular_distance_traveled=self.moved(status))


class BackUpGoal(MotionGoal):
    """`back_up`: drive straight back."""

    action = "back_up"
    messages = BackUp
    motion = NavigateGoal.REVERSE

    @property
    def amount(self) -> float:
        """How far to drive back [m]; Nav2 takes the amount of `target.x`, whatever its sign."""
        return abs(float(self.goal.goal.target.x))

    @property
    def speed(self) -> float:
        """The highest speed [m/s]."""
        return abs(float(self.goal.goal.speed))

    def feedback(self, status: NavigationStatus, _: PoseStamped) -> BackUp.Feedback:
        """Return how far the robot has driven."""
        return BackUp.Feedback(distance_traveled=self.moved(status))


def goal_message(action: str, goals: Sequence[Pose]) -> Any:
    """Return the goal of an action with these poses in frame map, as after a restart."""
    poses = tuple(
        PoseStamped(header=Header(frame_id="map"), pose=pose_message(one)) for one in goals
    )
    if action == ToPose.action:
        return NavigateToPose.Goal(pose=poses[-1])
    if action == ThroughPoses.action:
        return NavigateThroughPoses.Goal(poses=poses)
    return FollowWaypoints.Goal(poses=poses)


def _common(status: NavigationStatus, pose: PoseStamped) -> dict[str, Any]:
    return {
        "current_pose": pose,
        "navigation_time": duration_message(status.elapsed),
        "estimated_time_remaining": duration_message(status.time_left),
        "number_of_recoveries": min(status.recoveries, 2**15 - 1),
        # A float32, where the status has a float64, and may come from another machine.
        "distance_remaining": min(status.distance_left, _LONGEST_M),
    }


def planar_goals(goal: ActionGoal) -> list[Pose]:
    """Return the poses of a goal in frame map: x, y [m], heading [rad].

    Raises `CairnError` if there is none to drive to, `WrongFrame` if one is in another frame.
    """
    poses = goal.poses
    if goal.first >= len(poses):
        raise CairnError(f"the goal has {len(poses)} poses, and begins with pose {goal.first + 1}")
    return [pose_in_map(pose, f"pose {number}") for number, pose in enumerate(poses, 1)]
