"""The supervisor of a mobile robot: accepts missions, and keeps each until it has its result."""

from collections.abc import Mapping
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
from cairn.planar.messages import WrongFrame, packed_poses, planar_pose, planar_poses
from cairn.schemas.cairn_nav_msgs import (
    MAX_GOALS,
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    LocalizationEstimate,
    NavigateGoal,
    NavigationStatus,
    Zone,
    Zones,
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
    ActionRecord,
    Coordinate,
    Goal,
    Mission,
    MissionFile,
    MotionRecord,
    parse_goals,
    parse_token,
)

# A mission is continued at most so often: one that is under way whenever this component dies may be
# the reason why it dies.
_MOST_RESUMED = 3
_LONGEST_RESULT = 1000  # characters
_EXPLORATION = "exploration"  # token of the explorer's missions


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

    Accepts missions (the actions of Nav2 `navigate_to_pose`, `navigate_through_poses`,
    `follow_waypoints`, `spin` and `back_up`; requests `go` and `cancel`, topic `goal_pose`,
    parameter `mission`; the request `mission` returns the last one), loads AutoMove for the first
    unless it is loaded, and keeps each mission until it has its result, so that an AutoMove that
    was restarted continues it.

    Goals on `exploration_goal` preempt each other and no mission of anyone else; one without goals
    cancels the one before.
    """

    config: MobileSupervisorConfig

    request_roles = MappingProxyType({"go": "operate", "cancel": "operate", "mission": "view"})
    service_roles = MappingProxyType(
        dict.fromkeys(
            (ToPose.action, ThroughPoses.action, Waypoints.action, "spin", "back_up"), "operate"
        )
    )
    request_max_bytes = MappingProxyType({"go": 256 << 10})
    urgent_requests = frozenset({"cancel"})
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
    zones: In[Zones] = In(qos=LATCHED, optional=True)
    localization: In[LocalizationEstimate] = In(optional=True)
    navigate_goal: Out[NavigateGoal] = Out(qos=LATCHED)

    _mission: Mission | None = None
    _retrying = False  # a retry of saving the mission is scheduled
    _zones: tuple[Zone, ...] | None = None  # not known yet
    _goal: ActionGoal | None = None  # that of the mission under way, if it is of an action

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
            self._start(self.config.mission, configured=True)

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer `go` with `goals` [[x, y, heading], ...], `cancel`, `mission`, and the others.

        A goal may also be the name of a place on the map; the mission keeps where that is now. `go`
        may choose a `token` for its mission. `cancel` may name the `mission_id` or the `token` of
        the mission; otherwise it cancels the current one.
        """
        if verb == "go" and {"goals"} <= set(arguments) <= {"goals", "token"}:
            goals = parse_goals(arguments["goals"], self._zones)
            token = parse_token(arguments.get("token"))
            return {"mission_id": self._start(goals, token=token).mission_id}
        if verb == "cancel" and set(arguments) <= {"mission_id", "token"}:
            return {"mission_id": self._cancel(**arguments)}
        if verb == "mission" and not arguments:
            return self._mission.model_dump(mode="json") if self._mission is not None else None
        return super().on_request(verb, arguments)

    @on("goal_pose")
    def on_goal_pose(self, goal: PoseStamped) -> None:
        """Start a mission to a goal from RViz or any other node."""
        frame = goal.header.frame_id
        try:
            if frame not in ("", "map"):
                raise CairnError(f"the goal on {self.goal_pose.topic} is in frame {frame}, not map")
            self._start(parse_goals([planar_pose(goal.pose)]))
        except CairnError as error:
            self.log.error("mission rejected: %s", error)

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
        if mission is not None and not mission.result and mission.token != _EXPLORATION:
            if len(request.goals):
                self.log.info(
                    "exploration's goal refused: mission %d is under way", mission.mission_id
                )
            return
        try:
            if len(request.goals):
                goals = planar_poses(request.goals).tolist()
                self._start(parse_goals(goals), token=_EXPLORATION)
            elif mission is not None and not mission.result:
                self._close(mission, "canceled: the exploration has ended")
        except CairnError as error:
            self.log.error("mission rejected: %s", error)

    @on("zones")
    def on_zones(self, message: Zones) -> None:
        """Take the named places of the map."""
        self._zones = message.zones

    @on("navigation_status")
    def on_navigation_status(self, status: NavigationStatus) -> None:
        """Note the progress of the mission; close it when it has its result."""
        mission = self._mission
        if mission is None or mission.result or status.mission_id != mission.mission_id:
            return
        if status.state in NAVIGATION_END_STATES:
            success = status.state == NavigationStatus.SUCCEEDED
            reason = status.reason[:_LONGEST_RESULT]
            result = f"{NAVIGATION_STATES[status.state]}: {reason}"
            code = 0 if success else error_code(status.reason_code)
            if isinstance(self._goal, MotionGoal):
                self._goal.moved(status)
            if status.state == NavigationStatus.CANCELED or not self._goes_on(
                mission, None if success else status.goal, code
            ):
                self._close(mission, result, success=success, code=code)
        elif mission.first < status.goal <= len(mission.goals):
            self._update(mission.model_copy(update={"first": status.goal}))

    def _pursue(self, goal: ActionGoal) -> None:
        """Start a mission for the goal of an action; abort the goal if that is not possible."""
        try:
            goals = parse_goals(planar_goals(goal))
            self._start(goals, first=goal.first, action=goal)
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
            self._start((), action=goal, motion=motion)
        except CairnError as error:
            self.log.error("goal of %s not pursued: %s", goal.action, error)
            goal.goal.abort(goal.result(UNKNOWN_ERROR, str(error)))

    def _cancel_goal(self, goal: ServerGoal[Any, Any, Any]) -> None:
        mission = self._mission
        if mission is None or self._goal is None or self._goal.goal is not goal:
            raise CairnError("its mission is not under way")
        self._close(mission, "canceled: on request")

    def _start(
        self,
        goals: tuple[Goal, ...],
        *,
        configured: bool = False,
        token: str | None = None,
        first: int = 0,
        action: ActionGoal | None = None,
        motion: MotionRecord | None = None,
    ) -> Mission:
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
            token=token,
            first=first,
            action=None if action is None else action.record(),
            motion=motion,
        )
        if self._goal is not None and self._goal is not action:
            self._end_goal("aborted", UNKNOWN_ERROR, f"preempted by mission {mission.mission_id}")
        self._goal = action
        self.log.info("mission %d: %s", mission.mission_id, _described(mission))
        if mission.replaces_configured and self.config.finish:
            self.log.warning(
                "the configured mission is preempted: the deployment ends with mission %d",
                mission.mission_id,
            )
        self._update(mission)
        return mission

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

    def _cancel(self, *, mission_id: Any = None, token: Any = None) -> int:
        mission = self._mission
        if mission is None or mission.result or mission_id not in (None, mission.mission_id):
            which = "to cancel" if mission_id is None else f"{mission_id} under way"
            raise CairnError(f"{self.name}: there is no mission {which}")
        if token not in (None, mission.token):
            raise CairnError(f"{self.name}: the mission under way is of another client")
        self._close(mission, "canceled: on request")
        return mission.mission_id

    def _resume(self) -> None:
        """Continue the mission of an earlier process of this supervisor."""
        try:
            mission = self._file.load() if self._file is not None else None
            if mission is None or mission.result:
                self._mission = mission
                return
            if mission.resumed >= _MOST_RESUMED:
                why = f"failed: given up after {mission.resumed} restarts of {self.name}"
                self.log.error("mission %d %s", mission.mission_id, why)
                self._close(mission, why)
                return
            self._load_automove()
        except CairnError as error:
            self.log.error("mission not continued: %s", error)
            return
        self._restore_goal(mission)
        if mission.motion is not None:
            self._close(mission, f"failed: {self.name} was restarted meanwhile")
            return
        self.log.warning("mission %d continued", mission.mission_id)
        self._update(mission.model_copy(update={"resumed": mission.resumed + 1}))

    def _goes_on(self, mission: Mission, failed: int | None, code: int) -> bool:
        """Start the next mission for the same goal of an action, if it has a further one."""
        goal = self._goal
        if goal is None or not goal.goes_on(failed, code):
            return False
        if failed is not None:
            self.log.warning("waypoint %d not reached; the robot drives on", failed + 1)
        try:
            self._start(mission.goals, first=goal.first, action=goal)
        except CairnError as error:
            self.log.error("goal of %s not pursued any further: %s", goal.action, error)
            return False
        return True

    def _end_goal(self, outcome: str, code: int, text: str) -> None:
        """End the goal of an action whose mission has ended."""
        ended, self._goal = self._goal, None
        if ended is None or not ended.goal.is_active:
            return
        result = ended.result(code, text)
        if outcome == "succeeded":
            ended.goal.succeed(result)
        elif ended.goal.is_canceling:
            ended.goal.canceled(result)
        else:  # also if another client has canceled the mission
            ended.goal.abort(result)

    def _restore_goal(self, mission: Mission) -> None:
        """Continue to answer for the goal of an action that an earlier process accepted."""
        record = mission.action
        if record is None:
            return
        servers: dict[str, ActionServer[Any, Any, Any]] = {
            ToPose.action: self.navigate_to_pose,
            ThroughPoses.action: self.navigate_through_poses,
            Waypoints.action: self.follow_waypoints,
        }
        if mission.motion is not None:
            self._restore_motion(mission, record)
            return
        message = goal_message(record.name, mission.goals)
        goal = servers[record.name].restore(bytes.fromhex(record.goal_id), message)
        if record.name == ToPose.action:
            self._goal = ToPose(goal)
        elif record.name == ThroughPoses.action:
            self._goal = ThroughPoses(goal)
        else:
            waypoints = Waypoints(goal, stop_on_failure=self.config.stop_on_failure)
            waypoints.rounds_left = record.rounds_left
            waypoints.missed = list(record.missed)
            self._goal = waypoints

    def _restore_motion(self, mission: Mission, record: ActionRecord) -> None:
        """Answer for a motion: how far the robot has moved is not known, so it ends."""
        motion = mission.motion
        assert motion is not None
        identity = bytes.fromhex(record.goal_id)
        if record.name == SpinGoal.action:
            self._goal = SpinGoal(self.spin.restore(identity, Spin.Goal(target_yaw=motion.amount)))
        else:
            target = Point(x=-motion.amount)
            self._goal = BackUpGoal(self.back_up.restore(identity, BackUp.Goal(target=target)))

    def _close(
        self, mission: Mission, result: str, *, success: bool = False, code: int = UNKNOWN_ERROR
    ) -> None:
        self.log.info("mission %d %s", mission.mission_id, result)
        self._update(mission.model_copy(update={"result": result}))
        outcome, _, reason = result.partition(": ")
        if success:
            code, reason = 0, ""
        elif outcome == "canceled":
            code = 0
        self._end_goal(outcome, code, reason)
        if not self.config.finish:
            return
        if mission.configured:
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
            lambda: f"mission {mission.mission_id} does not continue where it is",
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
                first=mission.first,
                goals=packed_poses(np.array(goals, np.float64).reshape(-1, 3)),
                **(mission.motion.model_dump() if mission.motion and not mission.result else {}),
            )
        )


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
