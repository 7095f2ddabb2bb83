"""How an order to move is carried out: the paper's steps 3 to 6 for each goal, and recoveries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from planar.messages import pose_message
from planar.poses import Pose, distance
from schemas.cairn_nav_msgs import LocalizationHealth, MotionStatus, Movement, MoveStatus, Plan

# What is tried, one after the other, when the robot is lost, and when it cannot get on.
_WHEN_LOST = ("wait", "look_around", "explore", "look_around", "explore", "look_around")
_WHEN_STUCK = ("wait", "look_around", "back_off", "wait", "look_around", "wait")
_BEHAVIOUR = {
    "wait": Movement.STAND,
    "look_around": Movement.LOOK_AROUND,
    "explore": Movement.EXPLORE,
    "back_off": Movement.BACK_OFF,
}
# So much nearer to its goal [m] and whatever was in the way is overcome.
_PROGRESS_M = 0.3


@dataclass(frozen=True)
class Patience:
    """How long to wait for what; all in seconds but the first two."""

    recoveries: int = 6
    least_health: float = 0.3
    unsure_s: float = 1.0
    unlocated_s: float = 2.0
    blocked_s: float = 3.0
    stopped_s: float = 15.0
    stuck_s: float = 20.0
    planning_s: float = 10.0
    waiting_s: float = 4.0
    behaviour_s: float = 30.0


@dataclass
class Seen:
    """The last that the other components told; None before the first."""

    health: LocalizationHealth | None = None
    plan: Plan | None = None
    motion: MotionStatus | None = None
    pose: Pose | None = None


@dataclass
class Course:
    """One order: goals (in frame map) from number `at` on, and how far it has come.

    `tick` looks at what was seen and decides; `movement` is then what the planner and motion
    control are to do, and `state`, `reason` how it gets on. `leg` numbers what is wanted: it goes
    up with every new want.
    """

    order_id: int
    goals: Sequence[Pose]
    at: int
    leg: int
    began_s: float
    patience: Patience
    position_tolerance: float
    heading_tolerance: float
    state: int = MoveStatus.LOCALIZING
    reason: str = ""
    recoveries: int = 0
    behaviour: int = Movement.STAND
    _tries: int = 0
    _since_s: float = field(init=False)
    _good_s: float = field(init=False)
    _nearest_m: float = math.inf
    _progress_s: float = field(init=False)
    _trouble: str = ""
    _lost: bool = False

    def __post_init__(self) -> None:
        """Begin to wait now."""
        self._since_s = self._good_s = self._progress_s = self.began_s

    @property
    def over(self) -> bool:
        """Whether the order has its result."""
        return self.state in (MoveStatus.SUCCEEDED, MoveStatus.FAILED, MoveStatus.CANCELLED)

    @property
    def goal(self) -> Pose:
        """The goal being driven to, or the last one."""
        return self.goals[min(self.at, len(self.goals) - 1)]

    def cancel(self) -> None:
        """Take the order back."""
        self._end(MoveStatus.CANCELLED, "cancelled")

    def fail(self, reason: str) -> None:
        """Give up."""
        self._end(MoveStatus.FAILED, reason)

    def movement(self) -> Movement:
        """What the planner and motion control are to do now."""
        return Movement(
            leg=self.leg,
            behaviour=self.behaviour,
            goal=pose_message(self.goal),
            position_tolerance=self.position_tolerance,
            heading_tolerance=self.heading_tolerance,
        )

    def distance_left(self, seen: Seen) -> float:
        """To the goal [m]: along the path, or as the crow flies as long as there is none."""
        if seen.motion is not None and seen.motion.leg == self.leg and self._following(seen):
            return seen.motion.distance_left
        return distance(seen.pose, self.goal) if seen.pose is not None else 0.0

    def tick(self, now_s: float, seen: Seen) -> None:
        """Decide anew."""
        if self.over:
            return
        if self._located(seen):
            self._good_s = now_s
        if self.state == MoveStatus.LOCALIZING:
            self._localize(now_s, seen)
        elif self.state == MoveStatus.RECOVERING:
            self._recover(now_s, seen)
        elif now_s - self._good_s > self.patience.unsure_s:
            self._want(now_s, MoveStatus.LOCALIZING, Movement.STAND, _doubt(seen))
        elif self.state == MoveStatus.PLANNING:
            self._plan(now_s, seen)
        else:
            self._drive(now_s, seen)

    def _localize(self, now_s: float, seen: Seen) -> None:
        if self._located(seen):
            self._want(now_s, MoveStatus.PLANNING, Movement.FOLLOW, "")
        elif now_s - self._since_s > self.patience.unlocated_s:
            self._try_next(now_s, _WHEN_LOST, _doubt(seen))

    def _plan(self, now_s: float, seen: Seen) -> None:
        plan = seen.plan
        if plan is None or plan.leg != self.leg or plan.outcome == Plan.NOT_READY:
            if now_s - self._since_s > self.patience.planning_s:
                told = plan.reason if plan is not None and plan.leg == self.leg else ""
                self._try_next(now_s, _WHEN_STUCK, told or "the planner gives no answer")
        elif plan.outcome == Plan.OUTSIDE_MAP:
            self.fail(f"no path: {plan.reason}")
        elif plan.outcome == Plan.FOUND:
            self.state = MoveStatus.DRIVING
            self._since_s = self._progress_s = now_s
            self._nearest_m = math.inf
            self.reason = ""
        elif now_s - self._since_s > self.patience.blocked_s:
            self._try_next(now_s, _WHEN_STUCK, _no_path(plan))

    def _drive(self, now_s: float, seen: Seen) -> None:
        motion = seen.motion
        if motion is None or motion.leg != self.leg:
            self._wait_for_motion(now_s, "motion control gives no answer")
            return
        if motion.state == MotionStatus.DONE:
            self._reached(now_s)
            return
        left = motion.distance_left
        if left < self._nearest_m - _PROGRESS_M:
            if self._nearest_m < math.inf:
                self._tries = 0
            self._nearest_m, self._progress_s = left, now_s
        if motion.state == MotionStatus.MOVING:
            self._since_s = now_s
            self.reason = ""
            if now_s - self._progress_s > self.patience.stuck_s:
                self._try_next(now_s, _WHEN_STUCK, "the robot moves but gets no nearer")
            return
        self.reason = motion.reason
        if motion.state == MotionStatus.STOPPED:
            self._wait_for_motion(now_s, motion.reason)
        elif now_s - self._since_s > self.patience.blocked_s:
            plan = seen.plan
            no_path = plan is not None and plan.leg == self.leg and plan.outcome != Plan.FOUND
            reason = _no_path(plan) if plan is not None and no_path else motion.reason
            self._try_next(now_s, _WHEN_STUCK, reason)

    def _wait_for_motion(self, now_s: float, reason: str) -> None:
        self.reason = reason
        if now_s - self._since_s > self.patience.stopped_s:
            self.fail(reason)

    def _recover(self, now_s: float, seen: Seen) -> None:
        waited = now_s - self._since_s
        if self.behaviour == Movement.STAND:
            over = waited > self.patience.waiting_s
        else:
            motion = seen.motion
            ended = (
                motion is not None
                and motion.leg == self.leg
                and motion.state in (MotionStatus.DONE, MotionStatus.BLOCKED)
            )
            over = ended or waited > self.patience.behaviour_s
            # A robot that was lost and has found itself need not look any further.
            over = over or (self._lost and self._located(seen) and waited > 1.0)
        if over:
            self._want(now_s, MoveStatus.LOCALIZING, Movement.STAND, self._trouble)

    def _reached(self, now_s: float) -> None:
        self._tries = 0
        if self.at + 1 >= len(self.goals):
            self.at = len(self.goals)
            self._end(MoveStatus.SUCCEEDED, "arrived")
            return
        self.at += 1
        self._want(now_s, MoveStatus.PLANNING, Movement.FOLLOW, "")

    def _try_next(self, now_s: float, sequence: Sequence[str], reason: str) -> None:
        if self._tries >= self.patience.recoveries:
            self.fail(f"{reason} (after {self._tries} recoveries)")
            return
        what = sequence[self._tries % len(sequence)]
        self._tries += 1
        self.recoveries += 1
        self._trouble = reason
        self._lost = sequence is _WHEN_LOST
        self._want(
            now_s,
            MoveStatus.RECOVERING,
            _BEHAVIOUR[what],
            f"{reason}: {what.replace('_', ' ')} ({self._tries} of {self.patience.recoveries})",
        )

    def _want(self, now_s: float, state: int, behaviour: int, reason: str) -> None:
        self.state, self.behaviour, self.reason = state, behaviour, reason
        self.leg += 1
        self._since_s = self._progress_s = now_s
        self._good_s = now_s

    def _end(self, state: int, reason: str) -> None:
        self.state, self.reason = state, reason
        self.behaviour = Movement.STAND
        self.leg += 1

    def _following(self, seen: Seen) -> bool:
        return (
            self.state == MoveStatus.DRIVING
            and seen.motion is not None
            and seen.motion.state != MotionStatus.STANDING
        )

    def _located(self, seen: Seen) -> bool:
        health = seen.health
        return health is not None and health.located and health.health >= self.patience.least_health


def _doubt(seen: Seen) -> str:
    if seen.health is None:
        return "the localizer has told nothing yet"
    return seen.health.reason or "the robot is not located"


def _no_path(plan: Plan) -> str:
    nearest = ""
    if math.isfinite(plan.nearest_x):
        nearest = f"; the nearest reachable place is ({plan.nearest_x:.2f}, {plan.nearest_y:.2f})"
    return f"no path: {plan.reason}{nearest}"
