"""The component that carries out orders to move with the plugins it loads for them."""

from typing import Literal

from pydantic import Field

from cairn import LATCHED, SECOND, Config, In, Out, every, from_ns, on, to_ns
from cairn.components.automove.course import Course
from cairn.components.automove.goal_ids import GoalIds
from cairn.components.automove.recoveries import Patience
from cairn.components.automove.seen import Seen
from cairn.planar.messages import planar_pose, planar_poses, pose_message
from cairn.schemas.cairn_nav_msgs import (
    LocalizationHealth,
    MotionStatus,
    NavCommand,
    NavigateGoal,
    NavigationStatus,
    Plan,
    without_numbers,
)
from cairn.schemas.geometry_msgs import PoseWithCovarianceStamped
from cairn.schemas.std_msgs import Header
from cairn.supervision.component import SupervisorComponent
from cairn.supervision.supervisor import StartFailed

# How often what is wanted is told again, so that the others know that this component lives [ns].
_REPEAT = SECOND // 2


class AutoMoveConfig(Config):
    """When the plugins are loaded, and how an order is carried out."""

    load_plugins: Literal["on_request", "on_activation"] = Field(
        "on_request",
        description="On the first order to move; or at once, where somebody else drives the robot, "
        "as in a recording.",
    )
    position_tolerance: float = Field(
        0.10, gt=0, le=2, description="How near to a goal is there [m]."
    )
    heading_tolerance: float = Field(
        0.10, gt=0, le=3.2, description="How well turned at a goal is there [rad]."
    )
    recoveries: int = Field(
        6,
        ge=0,
        le=100,
        description="Recoveries without progress before it gives up; twice as many where the "
        "robot is lost, four at most where the map has no way to the goal [1].",
    )
    recoveries_per_goal: int = Field(
        30,
        ge=0,
        le=1000,
        description="Recoveries on the way to one goal, with progress or without, before it gives "
        "up [1].",
    )
    least_health: float = Field(
        0.3, ge=0, le=1, description="Health of the pose below which the robot stands still [1]."
    )
    sure_health: float = Field(
        0.5, ge=0, le=1, description="Health of the pose from which a goal counts as reached [1]."
    )
    stopped: float = Field(
        15.0, gt=0, le=600, description="How long inputs may be missing before it gives up [s]."
    )
    speed: float = Field(
        0.4, gt=0, le=5, description="Usual speed, for the estimate of the time left [m/s]."
    )


class AutoMove(SupervisorComponent):
    """Carries out an order to move (paper, steps 2 to 6).

    Loads Localizer, MapBuilder, PathPlanner and MotionControl; then has the robot localized, the
    path planned and driven, goal by goal, and recovers where one of these fails.
    """

    config: AutoMoveConfig

    navigate_goal: In[NavigateGoal] = In(qos=LATCHED, optional=True)
    plan: In[Plan] = In(qos=LATCHED, optional=True)
    motion_status: In[MotionStatus] = In(optional=True)
    pose: In[PoseWithCovarianceStamped] = In(optional=True)
    localization_health: In[LocalizationHealth] = In(optional=True)
    nav_command: Out[NavCommand] = Out(qos=LATCHED)
    navigation_status: Out[NavigationStatus] = Out(qos=LATCHED)

    _course: Course | None = None
    _told: tuple[int, int, int, str] | None = None
    _told_at = 0

    def on_configure(self) -> None:
        """Nothing was seen yet, and nothing is wanted."""
        self._seen = Seen()
        self._goal_ids = GoalIds()

    def on_activate(self) -> None:
        """Load what the configuration says is loaded before any order."""
        super().on_activate()
        if self.config.load_plugins == "on_activation":
            for child in self.children.status():
                self._load(child.name)

    @on("navigate_goal")
    def take(self, order: NavigateGoal) -> None:
        """Take an order: a new one pre-empts the old, one without goals takes it back."""
        course = self._course
        if not len(order.goals):
            if course is not None and not course.over and course.mission_id == order.mission_id:
                course.cancel()
                self._note_change(course)
            return
        if course is not None and course.mission_id == order.mission_id:
            return  # the order under way, told again
        if order.first >= len(order.goals):
            return
        if course is not None and not course.over:
            self.log.info("order %d is pre-empted by order %d", course.mission_id, order.mission_id)
        self._begin(order)

    @on("plan")
    def note_plan(self, plan: Plan) -> None:
        """Keep the planner's answer."""
        self._seen.plan = plan

    @on("motion_status")
    def note_motion(self, status: MotionStatus) -> None:
        """Keep what motion control does; an end of it is acted on at once."""
        self._seen.motion, self._seen.motion_s = status, self.clock.now() / SECOND
        if status.state == MotionStatus.DONE:
            self.decide()

    @on("pose")
    def note_pose(self, pose: PoseWithCovarianceStamped) -> None:
        """Keep where the robot is, and where it came from."""
        self._seen.note_pose(planar_pose(pose.pose.pose))

    @on("localization_health")
    def note_health(self, health: LocalizationHealth) -> None:
        """Keep how sure that is."""
        self._seen.health, self._seen.health_s = health, self.clock.now() / SECOND

    @every(hz=10)
    def decide(self) -> None:
        """Carry the order on, and tell what is wanted and how it gets on."""
        course = self._course
        if course is None:
            return
        before = course.state, course.goal_id
        course.tick(self.clock.now() / SECOND, self._seen)
        if (course.state, course.goal_id) != before:
            self._note_change(course)
        else:
            self._tell(course)

    def _begin(self, order: NavigateGoal) -> None:
        config = self.config
        now, given = self.clock.now(), to_ns(order.header.stamp)
        self._course = course = Course(
            mission_id=order.mission_id,
            goals=[(x, y, theta) for x, y, theta in planar_poses(order.goals).tolist()],
            at=order.first,
            next_goal_id=lambda: self._goal_ids.next(self.clock.now()),
            # One that a forerunner of this component began goes on.
            began_s=(min(given, now) or now) / SECOND,
            patience=Patience(
                recoveries=config.recoveries,
                recoveries_per_goal=config.recoveries_per_goal,
                least_health=config.least_health,
                sure_health=config.sure_health,
                stopped_s=config.stopped,
            ),
        )
        x, y, _ = course.goal
        self.log.info(
            "order %d: goal %d of %d at (%.2f, %.2f)",
            order.mission_id, course.at + 1, len(course.goals), x, y,
        )  # fmt: skip
        self._load_plugins(course)
        self._note_change(course)
        self.decide()

    def _load_plugins(self, course: Course) -> None:
        """Load what is not loaded yet, and tell what takes its time."""
        try:
            for child in self.children.status():
                if child.state != "active":
                    course.reason = child.name
                    self._tell(course)
                self._load(child.name)
        except StartFailed as error:  # those that are loaded already go on with their work
            course.fail(f"not all plugins can be loaded: {error}")
        else:
            course.loaded(self.clock.now() / SECOND)

    def _load(self, name: str) -> None:
        try:
            self.children.load(name)
        except StartFailed:
            if not self.children.stop_requested:  # else nobody needs the plugins any more
                raise

    def _note_change(self, course: Course) -> None:
        self._log(course)
        self._tell(course)

    def _tell(self, course: Course) -> None:
        now = self.clock.now()
        told = (course.goal_id, course.state, course.at, without_numbers(course.reason))
        if told == self._told and now - self._told_at < _REPEAT:
            return
        self._told, self._told_at = told, now
        header = Header(stamp=from_ns(now), frame_id="map")
        self.nav_command.publish(
            NavCommand(
                header=header,
                goal_id=course.goal_id,
                behavior=course.behavior,
                goal=pose_message(course.target),
                distance=course.explores_m,
                position_tolerance=self.config.position_tolerance,
                heading_tolerance=self.config.heading_tolerance,
            )
        )
        left_m = 0.0 if course.over else course.distance_left(self._seen)
        self.navigation_status.publish(
            NavigationStatus(
                header=header,
                mission_id=course.mission_id,
                state=course.state,
                goal=course.at,
                goals=len(course.goals),
                distance_left=left_m,
                time_left=left_m / self.config.speed,
                elapsed=max(0.0, now / SECOND - course.began_s),
                recoveries=course.recoveries,
                reason=course.reason,
            )
        )

    def _log(self, course: Course) -> None:
        x, y, _ = course.goal
        match course.state:
            case NavigationStatus.LOCALIZING if course.reason:
                self.log.warning("the robot stands: %s", course.reason)
            case NavigationStatus.DRIVING:
                self.log.info("driving to (%.2f, %.2f)", x, y)
            case NavigationStatus.RECOVERING:
                self.log.warning("recovering: %s", course.reason)
            case NavigationStatus.SUCCEEDED | NavigationStatus.CANCELED:
                self.log.info("order %d: %s", course.mission_id, course.reason)
            case NavigationStatus.FAILED:
                self.log.error("order %d failed: %s", course.mission_id, course.reason)
