"""The component AutoMove: carries out missions with the plugins that it loads for them."""

from typing import Literal

from pydantic import Field

from cairn import (
    LATCHED,
    SECOND,
    Config,
    In,
    Out,
    StartFailed,
    SteadyClock,
    Supervisor,
    every,
    from_ns,
    has_passed,
    on,
    to_ns,
)
from cairn.components.automove.inputs import MissionInputs
from cairn.components.automove.motion_mission import MotionMission
from cairn.components.automove.recovery_selection import MissionLimits
from cairn.components.automove.state_machine import CommandIds, MissionStateMachine
from cairn.planar.messages import planar_pose, planar_poses, pose_message
from cairn.processes.child import ChildStatus
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigateGoal,
    NavigationStatus,
    Plan,
    Reason,
    ReasonCode,
)
from cairn.schemas.std_msgs import Header

# The command is repeated so often, so that its readers know that AutoMove is alive [ns].
_REPEAT_S = 0.5
# Between two of ten steps in a second no more time passes [s]; a longer one is a step of the clock,
# or plugins were being loaded, during which nothing arrives.
_LONGEST_STEP_S = 1.0
# A longer time to the goal is not reported [s]: 30 years; dividing by a speed could give infinity.
_LONGEST_S = 1e9


class AutoMoveConfig(Config):
    """Parameters of AutoMove."""

    load_plugins: Literal["on_request", "on_activation"] = Field(
        "on_request",
        description="When the children are loaded: on the first mission, or on activation, which "
        "suits a robot that is not driven by AutoMove, as in a recording.",
    )
    position_tolerance: float = Field(
        0.10, gt=0, le=2, description="Distance to a goal at which it counts as reached [m]."
    )
    heading_tolerance: float = Field(
        0.10, gt=0, le=3.2, description="Heading error at which a goal counts as reached [rad]."
    )
    recoveries: int = Field(
        6,
        ge=0,
        le=100,
        description="Recoveries without progress before the mission fails; twice as many while the "
        "robot is lost, at most four while no path leads to the goal [1].",
    )
    recoveries_per_goal: int = Field(
        30,
        ge=0,
        le=1000,
        description="Recoveries for one goal, with or without progress, before the mission fails "
        "[1].",
    )
    least_health: float = Field(
        0.3, ge=0, le=1, description="Health of the pose below which the robot stands still [1]."
    )
    sure_health: float = Field(
        0.5, ge=0, le=1, description="Health of the pose from which a goal counts as reached [1]."
    )
    stopped: float = Field(
        15.0, gt=0, le=600, description="Time for which inputs may be missing before failing [s]."
    )
    speed: float = Field(
        0.4, gt=0, le=5, description="Usual speed, for the estimate of the time left [m/s]."
    )


class AutoMove(Supervisor):
    """Carries out missions (paper, steps 2 to 6).

    Loads Localizer, MapBuilder, PathPlanner and MotionControl. Then, for each goal, has the robot
    localized, a path planned and driven, and starts recovery behaviors where one of these fails.
    """

    config: AutoMoveConfig

    navigate_goal: In[NavigateGoal] = In(qos=LATCHED, optional=True)
    plan: In[Plan] = In(qos=LATCHED, optional=True)
    motion_status: In[MotionStatus] = In(optional=True)
    localization: In[LocalizationEstimate] = In(optional=True)
    nav_command: Out[NavCommand] = Out(qos=LATCHED)
    navigation_status: Out[NavigationStatus] = Out(qos=LATCHED)

    _mission: MissionStateMachine | MotionMission | None = None
    _activated_ns = 0
    _published: tuple[int, ...] | None = None
    _published_at = 0
    _under_way_s = 0.0  # the last time at which the mission had no result

    def on_configure(self) -> None:
        """Start without inputs."""
        self._inputs = MissionInputs()
        self._command_ids = CommandIds()
        self._steady = SteadyClock(self.clock, _LONGEST_STEP_S)

    def on_activate(self) -> None:
        """Load the children that the configuration does not load with the first mission."""
        self._activated_ns = self.clock.now()
        super().on_activate()
        if self.config.load_plugins == "on_activation":
            for child in self._plugins():
                self._load(child.name)

    @on("navigate_goal")
    def on_navigate_goal(self, request: NavigateGoal) -> None:
        """Start a mission, which preempts the current one; without goals, cancel it."""
        current = self._mission
        if not len(request.goals) and not request.motion:
            same = current is not None and current.mission_id == request.mission_id
            if current is not None and same and not current.finished:
                current.cancel()
                self._log_and_publish(current)
            return
        if current is not None and current.mission_id == request.mission_id:
            return  # the current mission, published again
        if not request.motion and request.first >= len(request.goals):
            return
        if current is not None and not current.finished:
            self.log.info(
                "mission %d preempted by mission %d", current.mission_id, request.mission_id
            )
        self._start(request)

    @on("plan")
    def on_plan(self, plan: Plan) -> None:
        """Keep the planner's answer."""
        self._inputs.plan = plan

    @on("motion_status")
    def on_motion_status(self, status: MotionStatus) -> None:
        """Keep the state of motion control; react to a finished behavior at once."""
        self._inputs.motion, self._inputs.motion_s = status, self._now_s()
        if status.state == MotionStatus.DONE:
            self.step()

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Keep the robot's pose and its health."""
        inputs = self._inputs
        inputs.localization, inputs.localization_s = estimate, self._now_s()
        if estimate.located:
            inputs.set_pose(planar_pose(estimate.pose.pose))

    @every(hz=10)
    def step(self) -> None:
        """Advance the mission, and publish command and status."""
        now_s, mission = self._now_s(), self._mission
        if mission is None:
            return
        before = mission.state, mission.command_id
        mission.step(now_s, self._inputs)
        if (mission.state, mission.command_id) != before:
            self._log_and_publish(mission)
        else:
            self._publish(mission)

    def _start(self, request: NavigateGoal) -> None:
        now_s, requested = self._now_s(), to_ns(request.header.stamp)
        age_s = max(0, self.clock.now() - requested) / SECOND if requested else 0.0
        mission: MissionStateMachine | MotionMission
        if request.motion:
            mission = MotionMission(
                mission_id=request.mission_id,
                goal_id=request.goal_id,
                request=request,
                next_command_id=self._next_command_id,
                started_s=now_s,
                limits=self._limits(),
            )
        else:
            mission = MissionStateMachine(
                mission_id=request.mission_id,
                goal_id=request.goal_id,
                goals=[(x, y, theta) for x, y, theta in planar_poses(request.goals).tolist()],
                goal_index=request.first,
                next_command_id=self._next_command_id,
                # A mission that an earlier process of AutoMove started continues.
                started_s=now_s - age_s,
                limits=self._limits(),
            )
        self._mission = mission
        if request.motion and self.restarts and requested < self._activated_ns:
            why = "AutoMove was restarted, and does not know how far the robot has moved"
            mission.fail(Reason(ReasonCode.LOADING_FAILED, why))
            self._log_and_publish(mission)
            return
        began = self.clock.now()
        self._load_plugins(mission)
        # Nothing arrives meanwhile, so the mission is not judged by it; but it does take the time.
        loading_s = (self.clock.now() - began) / SECOND - (self._now_s() - now_s)
        mission.started_s -= max(0.0, loading_s)
        self._log_and_publish(mission)
        self.step()

    def _now_s(self) -> float:
        """Return the time [s] by which the mission is judged: without steps of the clock."""
        return self._steady.now() / SECOND

    def _next_command_id(self) -> int:
        return self._command_ids.next(self.clock.now())

    def _limits(self) -> MissionLimits:
        config = self.config
        return MissionLimits(
            recoveries=config.recoveries,
            recoveries_per_goal=config.recoveries_per_goal,
            least_health=config.least_health,
            sure_health=config.sure_health,
            stopped_s=config.stopped,
        )

    def _load_plugins(self, mission: MissionStateMachine | MotionMission) -> None:
        """Load the children that are not loaded yet, and publish which one is being loaded."""
        try:
            for child in self._plugins():
                if child.state != "active":
                    mission.reason = Reason(ReasonCode.LOADING, child.name)
                    self._published = None
                    self._publish(mission)
                self._load(child.name)
        except StartFailed as error:  # children that are loaded already keep running
            reason = f"not all plugins can be loaded: {error}"
            mission.fail(Reason(ReasonCode.LOADING_FAILED, reason))
        else:
            mission.on_plugins_loaded(self._now_s())

    def _plugins(self) -> list[ChildStatus]:
        """Return the children that a mission needs."""
        return [one for one in self.children.status() if not one.fallback_of]

    def _load(self, name: str) -> None:
        try:
            self.children.load(name)
        except StartFailed:
            if not self.children.stop_requested:  # while stopping, no plugins are needed any more
                raise

    def _log_and_publish(self, mission: MissionStateMachine | MotionMission) -> None:
        self._log(mission)
        self._publish(mission)

    def _publish(self, mission: MissionStateMachine | MotionMission) -> None:
        """Publish command and status when they change, and periodically."""
        now = self.clock.now()
        if not mission.finished:
            self._under_way_s = self._now_s()
        version = (
            mission.command_id,
            mission.state,
            mission.goal_index,
            int(mission.reason.code),
        )
        if version == self._published and not has_passed(_REPEAT_S, self._published_at, now):
            return
        self._published, self._published_at = version, now
        header = Header(stamp=from_ns(now), frame_id="map")
        self.nav_command.publish(
            NavCommand(
                header=header,
                command_id=mission.command_id,
                behavior=mission.behavior,
                goal=pose_message(mission.target),
                distance=mission.distance,
                angle=mission.angle,
                speed=mission.speed,
                position_tolerance=self.config.position_tolerance,
                heading_tolerance=self.config.heading_tolerance,
            )
        )
        left_m = 0.0 if mission.finished else mission.distance_left(self._inputs)
        self.navigation_status.publish(
            NavigationStatus(
                header=header,
                mission_id=mission.mission_id,
                goal_id=mission.goal_id,
                state=mission.state,
                goal=mission.goal_index,
                goals=len(mission.goals),
                distance_left=left_m,
                time_left=min(left_m / self.config.speed, _LONGEST_S),
                elapsed=max(0.0, self._under_way_s - mission.started_s),
                recoveries=mission.recoveries,
                reason=mission.reason.text,
                reason_code=int(mission.reason.code),
            )
        )

    def _log(self, mission: MissionStateMachine | MotionMission) -> None:
        reason = mission.reason.text
        match mission.state:
            case NavigationStatus.LOCALIZING if reason:
                self.log.warning("waiting for the robot to be localized: %s", reason)
            case NavigationStatus.DRIVING if isinstance(mission, MotionMission):
                what = "turning" if mission.angle else "driving back"
                self.log.info("mission %d: %s", mission.mission_id, what)
            case NavigationStatus.DRIVING:
                assert isinstance(mission, MissionStateMachine)
                x, y, _ = mission.goal
                self.log.info(
                    "mission %d: driving to goal %d of %d at (%.2f, %.2f)",
                    mission.mission_id, mission.goal_index + 1, len(mission.goals), x, y,
                )  # fmt: skip
            case NavigationStatus.RECOVERING:
                self.log.warning("recovering: %s", reason)
            case NavigationStatus.FAILED:
                self.log.error("mission %d failed: %s", mission.mission_id, reason)
