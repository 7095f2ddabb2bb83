"""The supervisor of a mobile robot: accepts missions, and keeps each until it has its result."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import Field

from cairn import (
    LATCHED,
    SECOND,
    ActionServer,
    CairnError,
    Config,
    In,
    Out,
    RetriedSave,
    ServerGoal,
    StartFailed,
    Supervisor,
    cancel,
    every,
    from_ns,
    goal,
    on,
)
from cairn.planar.messages import WrongFrame, packed_poses, planar_poses
from cairn.schemas.cairn_nav_msgs import (
    MAX_GOALS,
    NAVIGATION_END_STATES,
    LocalizationEstimate,
    MissionOutcome,
    NavigateGoal,
    NavigationStatus,
    ReasonCode,
)
from cairn.schemas.geometry_msgs import Point, PoseStamped
from cairn.schemas.nav2_msgs.action import (
    BackUp,
    FollowWaypoints,
    NavigateThroughPoses,
    NavigateToPose,
    Spin,
)
from cairn.schemas.std_msgs import Header
from cairn.schemas.unique_identifier_msgs.msg import UUID
from cairn.supervisors.mobile.action_goals import (
    FRAME_ERROR,
    UNKNOWN_ERROR,
    ActionGoal,
    BackUpGoal,
    MotionGoal,
    SpinGoal,
    ThroughPoses,
    ToPose,
    Waypoints,
    error_code,
    goal_message,
    planar_goals,
)
from cairn.supervisors.mobile.mission_file import (
    Coordinate,
    Goal,
    Mission,
    MissionFile,
    MissionResult,
    MotionRecord,
    check_goals,
)

# A mission is continued at most so often: one that is under way whenever this component dies may be
# the reason why it dies.
_MOST_RESUMED = 3
_LONGEST_REASON = 1000  # characters


class MobileSupervisorConfig(Config):
    """Parameters of the supervisor of a mobile robot."""

    mission: tuple[tuple[Coordinate, Coordinate, Coordinate], ...] = Field(
        (),
        max_length=MAX_GOALS,
        description="Goals to drive to from the start: x [m], y [m], heading [rad].",
    )
    automove: str = Field(
        "automove",
        description="The child that carries out missions; loaded with the first mission.",
    )
    finish: bool = Field(
        False,
        description="Whether the deployment ends when its mission ends; if another mission "
        "preempts it, when that one ends.",
    )
    stop_on_failure: bool = Field(
        True,
        description="Whether the action follow_waypoints ends with the first waypoint that cannot "
        "be reached; otherwise the robot drives on to the next one.",
    )
    state_file: Path | None = Field(
        None,
        description="File of the mission's goals, beside which its progress is kept; a restarted "
        "supervisor continues from them. None: the mission is lost, and the robot stands.",
    )


class MobileSupervisor(Supervisor):
    """Keeps the base, the range scanner and AutoMove running (paper, step 1).

    Each mission is a goal of one of Nav2's actions `navigate_to_pose`, `navigate_through_poses`,
    `follow_waypoints`, `spin` and `back_up`, by which it has its result and can be canceled; also
    one that comes by the topic `goal_pose`, from the explorer, or as the parameter `mission`. This
    supervisor loads AutoMove for the first one unless it is loaded, and keeps each mission until it
    has its result, so that an AutoMove that was restarted continues it.

    Goals on `exploration_goal` preempt each other and no mission of anyone else; one without goals
    cancels the one before.
    """

    config: MobileSupervisorConfig

    service_roles = MappingProxyType(
        dict.fromkeys(
            (ToPose.action, ThroughPoses.action, Waypoints.action, "spin", "back_up"), "operate"
        )
    )
    operator_inputs = frozenset({"goal_pose"})

    navigate_to_pose: ActionServer[
        NavigateToPose.Goal, NavigateToPose.Result, NavigateToPose.Feedback
    ]
    navigate_through_poses: ActionServer[
        NavigateThroughPoses.Goal, NavigateThroughPoses.Result, NavigateThroughPoses.Feedback
    ]
    follow_waypoints: ActionServer[
        FollowWaypoints.Goal, FollowWaypoints.Result, FollowWaypoints.Feedback
    ]

    spin: ActionServer[Spin.Goal, Spin.Result, Spin.Feedback]
    back_up: ActionServer[BackUp.Goal, BackUp.Result, BackUp.Feedback]

    goal_pose: In[PoseStamped] = In(optional=True)
    exploration_goal: In[NavigateGoal] = In(optional=True)
    navigation_status: In[NavigationStatus] = In(qos=LATCHED.with_depth(20), optional=True)
    localization: In[LocalizationEstimate] = In(optional=True)
    navigate_goal: Out[NavigateGoal] = Out(qos=LATCHED)

    _mission: Mission | None = None
    _retrying = False  # a retry of saving the mission is scheduled
    _goal: ActionGoal | None = None  # that of the mission under way

    def on_configure(self) -> None:
        """Check that missions can be kept; remove that of an earlier run."""
        self._saved_mission = RetriedSave(self, "mission")
        self._retrying = False
        file = self.config.state_file
        self._file = None if file is None else MissionFile(file)
        if self._file is None or file is None:
            return
        if not file.parent.is_dir():
            raise CairnError(f"{file.parent}: no such folder to keep the mission in (state_file)")
        if self.restarts == 0:
            self._file.remove()

    def on_activate(self) -> None:
        """Start the children; start the configured mission, or continue the one before."""
        self._retrying = False
        super().on_activate()
        if self.restarts > 0:
            self._resume()
        elif self.config.mission:
            goals = self.config.mission
            self._start(goals, ThroughPoses(self._own_goal(goals)), configured=True)

    @on("goal_pose")
    def on_goal_pose(self, goal: PoseStamped) -> None:
        """Start a mission to a goal from RViz or any other node."""
        message = NavigateToPose.Goal(pose=goal)
        self._pursue(ToPose(self.navigate_to_pose.restore(self._own_goal_id(), message)))

    @goal("navigate_to_pose")
    def on_navigate_to_pose(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Start a mission to one pose."""
        self._pursue(ToPose(goal))

    @goal("navigate_through_poses")
    def on_navigate_through_poses(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Start a mission to several poses."""
        self._pursue(ThroughPoses(goal))

    @goal("follow_waypoints")
    def on_follow_waypoints(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Start a mission to several poses, which may go on if one cannot be reached."""
        self._pursue(Waypoints(goal, stop_on_failure=self.config.stop_on_failure))

    @goal("spin")
    def on_spin(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Turn on the spot, after having ended the mission under way."""
        self._move(SpinGoal(goal))

    @goal("back_up")
    def on_back_up(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Drive straight back, after having ended the mission under way."""
        self._move(BackUpGoal(goal))

    @cancel("navigate_to_pose")
    def on_cancel_to_pose(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Cancel the mission."""
        self._cancel_goal(goal)

    @cancel("navigate_through_poses")
    def on_cancel_through_poses(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Cancel the mission."""
        self._cancel_goal(goal)

    @cancel("follow_waypoints")
    def on_cancel_waypoints(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Cancel the mission."""
        self._cancel_goal(goal)

    @cancel("spin")
    def on_cancel_spin(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Stop turning."""
        self._cancel_goal(goal)

    @cancel("back_up")
    def on_cancel_back_up(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Stop driving back."""
        self._cancel_goal(goal)

    @every(hz=10)
    def publish_feedback(self) -> None:
        """Publish the progress of an action's goal."""
        goal, status = self._goal, self.navigation_status.latest
        estimate = self.localization.latest
        mission = self._mission
        if goal is None or status is None or mission is None:
            return
        if status.mission_id != mission.mission_id:
            return
        pose = PoseStamped()
        if estimate is not None:
            header = Header(stamp=estimate.header.stamp, frame_id="map")
            pose = PoseStamped(header=header, pose=estimate.pose.pose)
        goal.goal.publish_feedback(goal.feedback(status, pose))

    @on("exploration_goal")
    def on_exploration_goal(self, request: NavigateGoal) -> None:
        """Start or cancel a mission of the explorer, unless another one is under way."""
        mission = self._mission
        if mission is not None and not mission.result and not mission.explores:
            if len(request.goals):
                self.log.info(
                    "exploration's goal refused: mission %d is under way", mission.mission_id
                )
            return
        if len(request.goals):
            goal = self._own_goal(planar_poses(request.goals).tolist())
            self._pursue(ThroughPoses(goal), explores=True)
        elif mission is not None and not mission.result:
            self._close(mission, _canceled("the exploration has ended"))

    @on("navigation_status")
    def on_navigation_status(self, status: NavigationStatus) -> None:
        """Note the progress of the mission; close it when it has its result."""
        mission = self._mission
        if mission is None or mission.result or status.mission_id != mission.mission_id:
            return
        if status.state in NAVIGATION_END_STATES:
            result = MissionResult(
                outcome=MissionOutcome(status.state),
                code=status.reason_code,
                reason=status.reason[:_LONGEST_REASON],
            )
            if isinstance(self._goal, MotionGoal):
                self._goal.moved(status)
            if not self._goes_on(mission, result, status.goal):
                self._close(mission, result)
        elif mission.first < status.goal <= len(mission.goals):
            self._update(mission.model_copy(update={"first": status.goal}))

    def _own_goal(self, goals: Sequence[Goal]) -> ServerGoal[Any, Any, Any]:
        """Return a goal of `navigate_through_poses` that no client has sent."""
        message = goal_message(ThroughPoses.action, goals)
        return self.navigate_through_poses.restore(self._own_goal_id(), message)

    def _own_goal_id(self) -> bytes:
        """Return the id of a goal that no client has sent; of no other goal."""
        last = 0 if self._mission is None else self._mission.mission_id
        text = f"{self.navigate_to_pose.action} {last} {self.clock.now()}"
        return hashlib.blake2b(text.encode(), digest_size=16).digest()

    def _pursue(self, goal: ActionGoal, *, explores: bool = False) -> None:
        """Start a mission for the goal of an action; abort the goal if that is not possible."""
        try:
            self._start(check_goals(planar_goals(goal)), goal, first=goal.first, explores=explores)
        except CairnError as error:
            self.log.error("goal of %s not pursued: %s", goal.action, error)
            code = FRAME_ERROR if isinstance(error, WrongFrame) else UNKNOWN_ERROR
            goal.goal.abort(goal.result(code, str(error)))

    def _move(self, goal: MotionGoal) -> None:
        """Start a mission of one motion; abort the goal if that is not possible."""
        motion = MotionRecord(
            motion=goal.motion,
            amount=goal.amount,
            speed=goal.speed,
            time_allowance=goal.time_allowance,
        )
        try:
            self._start((), goal, motion=motion)
        except CairnError as error:
            self.log.error("goal of %s not pursued: %s", goal.action, error)
            goal.goal.abort(goal.result(UNKNOWN_ERROR, str(error)))

    def _cancel_goal(self, goal: ServerGoal[Any, Any, Any]) -> None:
        mission = self._mission
        if mission is None or self._goal is None or self._goal.goal is not goal:
            raise CairnError("its mission is not under way")
        self._close(mission, _canceled("on request"))

    def _start(
        self,
        goals: tuple[Goal, ...],
        action: ActionGoal,
        *,
        configured: bool = False,
        explores: bool = False,
        first: int = 0,
        motion: MotionRecord | None = None,
    ) -> None:
        self._load_automove()
        before = self._mission
        last = before.mission_id if before is not None else 0
        now = self.clock.now()
        mission = Mission(
            # Larger than any id that an earlier process of this supervisor used.
            mission_id=max(last + 1, now // SECOND & 0x7FFFFFFF),
            requested_ns=now,
            goals=goals,
            configured=configured,
            replaces_configured=before is not None and before.ends_configured and not before.result,
            explores=explores,
            first=first,
            action=action.record(),
            motion=motion,
        )
        if self._goal is not action:
            by = f"preempted by mission {mission.mission_id}"
            self._end_goal(_failed(ReasonCode.PREEMPTED, by))
        self._goal = action
        self.log.info("mission %d: %s", mission.mission_id, _described(mission))
        if mission.replaces_configured and self.config.finish:
            self.log.warning(
                "the configured mission is preempted: the deployment ends with mission %d",
                mission.mission_id,
            )
        self._update(mission)

    def _load_automove(self) -> None:
        name = self.config.automove
        if name not in {child.name for child in self.children.status()}:
            raise CairnError(
                f"{self.name} has no child {name} to carry out missions; add it, or correct the "
                "parameter automove"
            )
        try:
            self.children.load(name)
        except StartFailed as error:
            raise CairnError(f"{name} cannot be loaded: {error}") from error

    def _resume(self) -> None:
        """Continue the mission of an earlier process of this supervisor."""
        try:
            mission = self._file.load() if self._file is not None else None
        except CairnError as error:
            self.log.error("mission not continued: %s", error)
            return
        if mission is None:
            return
        self._mission, self._goal = mission, self._restored_goal(mission)
        if mission.result:  # its client may not have got that
            self._end_goal(mission.result)
        elif mission.resumed >= _MOST_RESUMED:
            self._give_up(mission, f"given up after {mission.resumed} restarts of {self.name}")
        elif mission.motion is not None:
            self._give_up(mission, f"{self.name} was restarted meanwhile")
        else:
            try:
                self._load_automove()
            except CairnError as error:
                self._give_up(mission, f"not continued after a restart: {error}")
                return
            self.log.warning("mission %d continued", mission.mission_id)
            self._update(mission.model_copy(update={"resumed": mission.resumed + 1}))

    def _give_up(self, mission: Mission, why: str) -> None:
        """End a mission of an earlier process of this supervisor as failed."""
        self._close(mission, _failed(ReasonCode.NOT_CONTINUED, why))

    def _goes_on(self, mission: Mission, result: MissionResult, at: int) -> bool:
        """Start the next mission for the same goal of an action, if it has a further one.

        `at` is the index of the goal at which the mission has ended.
        """
        goal = self._goal
        if goal is None or result.outcome is MissionOutcome.CANCELED:
            return False
        failed = at if result.outcome is MissionOutcome.FAILED else None
        if not goal.goes_on(failed, error_code(result.code)):
            return False
        if failed is not None:
            self.log.warning("waypoint %d not reached; the robot drives on", failed + 1)
        try:
            self._start(mission.goals, goal, first=goal.first, explores=mission.explores)
        except CairnError as error:
            self.log.error("goal of %s not pursued any further: %s", goal.action, error)
            return False
        return True

    def _end_goal(self, result: MissionResult) -> None:
        """End the goal of the mission that has ended with a result."""
        ended, self._goal = self._goal, None
        if ended is None or not ended.goal.is_active:
            return
        match result.outcome:
            case MissionOutcome.SUCCEEDED:
                ended.goal.succeed(ended.result(0, ""))
            case MissionOutcome.CANCELED:
                ended.goal.canceled(ended.result(0, result.reason))
            case MissionOutcome.FAILED:
                ended.goal.abort(ended.result(error_code(result.code), result.reason))

    def _restored_goal(self, mission: Mission) -> ActionGoal:
        """Return the goal of an action that an earlier process of this supervisor accepted."""
        record, motion = mission.action, mission.motion
        identity = bytes.fromhex(record.goal_id)
        if motion is not None and record.name == SpinGoal.action:
            return SpinGoal(self.spin.restore(identity, Spin.Goal(target_yaw=motion.amount)))
        if motion is not None:
            target = Point(x=-motion.amount)
            return BackUpGoal(self.back_up.restore(identity, BackUp.Goal(target=target)))
        message = goal_message(record.name, mission.goals)
        if record.name == ToPose.action:
            return ToPose(self.navigate_to_pose.restore(identity, message))
        if record.name == ThroughPoses.action:
            return ThroughPoses(self.navigate_through_poses.restore(identity, message))
        goal = self.follow_waypoints.restore(identity, message)
        waypoints = Waypoints(goal, stop_on_failure=self.config.stop_on_failure)
        waypoints.rounds_left = record.rounds_left
        waypoints.missed = list(record.missed)
        return waypoints

    def _close(self, mission: Mission, result: MissionResult) -> None:
        """End a mission."""
        self.log.info("mission %d %s", mission.mission_id, result)
        self._update(mission.model_copy(update={"result": result}))
        self._end_goal(result)
        if not self.config.finish:
            return
        if mission.configured:
            success = result.outcome is MissionOutcome.SUCCEEDED
            self.finish(f"the mission {result}", success=success)
        elif mission.replaces_configured:  # not earlier: the robot must not stop under its operator
            which = f"mission {mission.mission_id}"
            self.finish(f"the mission was preempted by {which}, which {result}", success=False)

    def _save_mission(self, *, now: bool = False) -> None:
        """Save the mission as it is now; while that fails, again later."""
        mission, file = self._mission, self._file
        if mission is None or file is None:
            return
        saved = self._saved_mission.attempt(
            lambda: file.save(mission),
            lambda: (
                f"mission {mission.mission_id} does not continue where it is"
                if file.holds(mission)
                else f"mission {mission.mission_id} is lost"
            ),
            now=now,
        )
        if not saved and not self._retrying:
            self._retrying = True
            self.schedule(self._saved_mission.due_ns, self._retry_mission)

    def _retry_mission(self) -> None:
        self._retrying = False
        self._save_mission()

    def _update(self, mission: Mission) -> None:
        """Keep the mission as it is now, and publish it to AutoMove."""
        self._mission = mission
        self._save_mission(now=True)
        goals = () if mission.result else mission.goals
        self.navigate_goal.publish(
            NavigateGoal(
                header=Header(stamp=from_ns(mission.requested_ns), frame_id="map"),
                mission_id=mission.mission_id,
                goal_id=UUID(uuid=np.frombuffer(bytes.fromhex(mission.action.goal_id), np.uint8)),
                first=mission.first,
                goals=packed_poses(np.array(goals, np.float64).reshape(-1, 3)),
                **(mission.motion.model_dump() if mission.motion and not mission.result else {}),
            )
        )


def _canceled(why: str) -> MissionResult:
    return MissionResult(outcome=MissionOutcome.CANCELED, code=ReasonCode.CANCELED, reason=why)


def _failed(code: ReasonCode, why: str) -> MissionResult:
    return MissionResult(outcome=MissionOutcome.FAILED, code=code, reason=why)


def _described(mission: Mission) -> str:
    """Return what a mission is, for the log."""
    motion = mission.motion
    if motion is not None and motion.motion == NavigateGoal.TURN:
        return f"turn by {motion.amount:.2f} rad"
    if motion is not None:
        return f"drive back {motion.amount:.2f} m"
    x, y, _ = mission.goals[-1]
    others = len(mission.goals) - 1
    via = f" via {others} other {'goal' if others == 1 else 'goals'}" if others else ""
    return f"go to ({x:.2f}, {y:.2f}){via}"
