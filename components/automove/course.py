"""How an order to move is carried out: the paper's steps 3 to 6 for each goal, and recoveries."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from cairn.components.automove.aside import Aside, give_way, go_near
from cairn.components.automove.recoveries import (
    BEHAVIOR,
    WHEN_LOST,
    WHEN_NO_WAY,
    WHEN_STUCK,
    WHEN_UNSURE,
    Patience,
)
from cairn.components.automove.seen import Seen
from cairn.planar.poses import Pose, distance
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    MotionStatus,
    NavCommand,
    NavigationStatus,
    Plan,
)

# So much nearer to its goal than before [m] and whatever was in the way is overcome.
_PROGRESS_M = 0.3
# What is so much longer [m] than what was left is another way: no recovery goes back so far on the
# same. Only so many longer ways to a goal are begun [1], or a robot sent to and fro between blocked
# ones would seem to get on for ever.
_DETOUR_M, _DETOURS = 2.0, 10
# What explores goes so far [m] at first, twice as far each time, and at most so far: where a place
# looks like another, it takes some way until one of them shows.
_EXPLORES_M, _EXPLORES_MOST_M = 2.0, 8.0


@dataclass
class Course:
    """One order: goals (in frame map) from number `at` on, and how far it has come.

    `tick` looks at what was seen and decides; `goal_id`, `behavior` and `target` are then what the
    planner and motion control are to do, and `state`, `reason` how it gets on. `goal_id` numbers
    the commands: each new command has a new one, from `next_goal_id`.
    """

    mission_id: int
    goals: Sequence[Pose]
    at: int
    next_goal_id: Callable[[], int]
    began_s: float
    patience: Patience = field(default_factory=Patience)
    state: int = NavigationStatus.LOADING
    reason: str = ""
    recoveries: int = 0
    behavior: int = NavCommand.STAND
    goal_id: int = field(init=False)
    # Where it goes instead while it gives way or goes near; how far it goes while it explores [m].
    instead: Aside | None = None
    explores_m: float = _EXPLORES_M
    # Without progress; for the goals before this one; to this goal: longer ways, explorations [1].
    _tries: int = 0
    _recovered_before: int = 0
    _detours: int = 0
    _explorations: int = 0
    _sequence: Sequence[str] = ()
    _trouble: str = ""
    _attempt: str = ""
    # The least that was left to this goal, of the way being taken [m].
    _nearest_m: float = math.inf
    # Since when: this state; the last sure pose; nearer to the goal; not stopped; not blocked [s].
    _since_s: float = field(init=False)
    _sure_s: float = field(init=False)
    _progress_s: float = field(init=False)
    _running_s: float = field(init=False)
    _moving_s: float = field(init=False)

    def __post_init__(self) -> None:
        """Stand; begin to wait now."""
        self.goal_id = self.next_goal_id()
        self._begin(self.began_s)

    @property
    def over(self) -> bool:
        """Whether the order has its result."""
        return self.state in NAVIGATION_END_STATES

    @property
    def goal(self) -> Pose:
        """The goal being driven to, or the last one."""
        return self.goals[min(self.at, len(self.goals) - 1)]

    @property
    def target(self) -> Pose:
        """What is planned to now: the goal, or where the robot goes instead."""
        return self.goal if self.instead is None else self.instead.place

    def loaded(self, now_s: float) -> None:
        """All that it takes is loaded: find out where the robot is."""
        self.state, self.reason = NavigationStatus.LOCALIZING, ""
        self._begin(now_s)

    def cancel(self) -> None:
        """Take the order back."""
        self._end(NavigationStatus.CANCELED, "taken back")

    def fail(self, reason: str) -> None:
        """Give up."""
        self._end(NavigationStatus.FAILED, reason)

    def distance_left(self, seen: Seen) -> float:
        """To the goal [m]: along the path, or as the crow flies as long as none is followed."""
        motion = seen.motion
        driving = self.state == NavigationStatus.DRIVING
        # Without a way to go, motion control tells no distance.
        if (
            driving
            and motion is not None
            and motion.goal_id == self.goal_id
            and motion.distance_left > 0.0
        ):
            return motion.distance_left
        return distance(seen.pose, self.goal) if seen.pose is not None else 0.0

    def tick(self, now_s: float, seen: Seen) -> None:
        """Decide anew."""
        doubt = self._doubt(now_s, seen)
        if self.over or self.state == NavigationStatus.LOADING:
            return
        if not doubt or now_s - seen.health_s > self.patience.silent_s:
            self._sure_s = now_s  # motion control stops for inputs that are missing, and says which
        if self.state == NavigationStatus.LOCALIZING:
            self._localize(now_s, seen, doubt)
        elif self.state == NavigationStatus.RECOVERING:
            self._recover(now_s, seen, doubt)
        elif now_s - self._sure_s > self.patience.unsure_s:
            self._want(now_s, NavigationStatus.LOCALIZING, NavCommand.STAND, doubt)
        elif self.state == NavigationStatus.PLANNING:
            self._plan(now_s, seen)
        else:
            self._drive(now_s, seen)

    def _localize(self, now_s: float, seen: Seen, doubt: str) -> None:
        waited = now_s - self._since_s
        if not doubt:
            self._want(now_s, NavigationStatus.PLANNING, NavCommand.FOLLOW, "")
            return
        self.reason = doubt
        if now_s - seen.health_s > self.patience.silent_s:  # moving would not make it talk
            if waited > self.patience.stopped_s:
                self.fail(doubt)
        elif waited > self.patience.unlocated_s:
            self._try_next(now_s, seen, WHEN_LOST, doubt)

    def _plan(self, now_s: float, seen: Seen) -> None:
        waited = now_s - self._since_s
        plan = seen.plan if seen.plan is not None and seen.plan.goal_id == self.goal_id else None
        if plan is None or plan.outcome == Plan.NOT_READY:
            self.reason = plan.reason if plan is not None else ""
            if waited > self.patience.planning_s:
                self._try_next(
                    now_s, seen, WHEN_STUCK, self.reason or "the planner gives no answer"
                )
        elif plan.outcome == Plan.FOUND:
            self.state, self.reason = NavigationStatus.DRIVING, ""
            self._begin(now_s)
        elif plan.outcome == Plan.OUTSIDE_MAP:
            self.fail(f"no path: {plan.reason}")
        else:
            self.reason = f"no path: {plan.reason}"
            if waited > self.patience.blocked_s:
                hemmed_in = plan.outcome == Plan.START_BLOCKED
                self._try_next(now_s, seen, WHEN_STUCK if hemmed_in else WHEN_NO_WAY, self.reason)

    def _drive(self, now_s: float, seen: Seen) -> None:
        halted, motion = self._halted(now_s, seen)
        if halted or motion is None:
            return
        if motion.state == MotionStatus.DONE:
            if self._sure(seen):
                self._reached(now_s)
            else:
                why = seen.health.reason if seen.health is not None else ""
                self._try_next(
                    now_s, seen, WHEN_UNSURE, f"at the goal, if the pose is right: {why}"
                )
            return
        if motion.distance_left > 0.0:
            self._note_progress(now_s, motion.distance_left)
        if motion.state == MotionStatus.MOVING:
            self._moving_s = now_s
            self.reason = ""
            if now_s - self._progress_s > self.patience.stuck_s:
                self._try_next(now_s, seen, WHEN_STUCK, "the robot moves but gets no nearer")
            return
        plan = seen.plan
        no_path = plan is not None and plan.goal_id == self.goal_id and plan.outcome != Plan.FOUND
        self.reason = f"no path: {plan.reason}" if plan is not None and no_path else motion.reason
        if now_s - self._moving_s > self.patience.blocked_s:
            self._try_next(now_s, seen, WHEN_STUCK, self.reason)

    def _note_progress(self, now_s: float, left_m: float) -> None:
        """Count the tries anew where less is left than ever, be it of another way.

        What a recovery undid and is driven again is no progress, or a robot that goes back from an
        obstacle and up to it again would never give up. But a way around the obstacle may be much
        longer than what was left: to get on along it is progress, though the robot has been nearer.
        """
        if left_m > self._nearest_m + _DETOUR_M and self._detours < _DETOURS:
            self._detours += 1
            self._nearest_m, self._progress_s = left_m, now_s
        elif left_m < self._nearest_m - _PROGRESS_M:
            if self._nearest_m < math.inf:
                self._tries = 0
            self._nearest_m, self._progress_s = left_m, now_s

    def _halted(self, now_s: float, seen: Seen) -> tuple[bool, MotionStatus | None]:
        """Whether motion control cannot work now; give up when that lasts too long."""
        motion = seen.motion
        silent_s = now_s - seen.motion_s
        if silent_s > self.patience.silent_s and motion is not None:
            self.reason = f"nothing was heard of motion control for {silent_s:.1f} s"
        elif motion is None or motion.goal_id != self.goal_id:
            self.reason = "motion control has not answered yet"
        elif motion.state == MotionStatus.STOPPED:
            self.reason = motion.reason
        else:
            self._running_s = now_s
            return False, motion
        self._moving_s = now_s
        if now_s - self._running_s > self.patience.stopped_s:
            self.fail(self.reason)
        return True, motion

    def _recover(self, now_s: float, seen: Seen, doubt: str) -> None:
        waited = now_s - self._since_s
        if self.behavior == NavCommand.STAND:
            over = waited > self.patience.waiting_s
        elif self.instead is not None:
            if doubt or self._is_aside(now_s, seen, self.instead):
                self._want(now_s, NavigationStatus.RECOVERING, NavCommand.STAND, self._attempt)
            return
        else:
            halted, motion = self._halted(now_s, seen)
            if halted or motion is None:
                return
            self.reason = self._attempt
            ended = motion.state in (MotionStatus.DONE, MotionStatus.BLOCKED)
            over = ended or waited > self.patience.behavior_s
        # A robot that was lost and has found itself need not look any further.
        found = self._sequence is WHEN_LOST and not doubt
        found = found or (self._sequence is WHEN_UNSURE and self._sure(seen))
        if over or (found and waited > self.patience.unsure_s):
            self._want(now_s, NavigationStatus.LOCALIZING, NavCommand.STAND, self._trouble)

    def _is_aside(self, now_s: float, seen: Seen, aside: Aside) -> bool:
        """Whether the robot is where it goes instead, or cannot get there soon."""
        plan = seen.plan if seen.plan is not None and seen.plan.goal_id == self.goal_id else None
        if plan is not None and (plan.outcome != Plan.FOUND or plan.length > aside.most_m):
            return True
        halted, motion = self._halted(now_s, seen)
        if halted or motion is None:
            return False
        self.reason = self._attempt
        if motion.state == MotionStatus.MOVING:
            self._moving_s = now_s
        blocked = now_s - self._moving_s > self.patience.unsure_s
        too_long = now_s - self._since_s > aside.most_s
        return motion.state == MotionStatus.DONE or blocked or too_long

    def _reached(self, now_s: float) -> None:
        self._tries = self._detours = self._explorations = 0
        self._recovered_before, self._nearest_m = self.recoveries, math.inf
        x, y, _ = self.goal
        self.at += 1
        if self.at >= len(self.goals):
            self._end(NavigationStatus.SUCCEEDED, f"arrived at ({x:.2f}, {y:.2f})")
        else:
            self._want(now_s, NavigationStatus.PLANNING, NavCommand.FOLLOW, "")

    def _try_next(self, now_s: float, seen: Seen, sequence: Sequence[str], trouble: str) -> None:
        most = self.patience.recoveries
        if sequence in (WHEN_LOST, WHEN_UNSURE):
            most *= 2  # where places look alike it takes some way until one stands out
        elif sequence is WHEN_NO_WAY:
            most = min(most, len(sequence))
        if self._tries >= most:
            tried = f" (after {self._tries} recoveries)" if self._tries else ""
            self.fail(trouble + tried)
            return
        here = self.recoveries - self._recovered_before
        if here >= self.patience.recoveries_per_goal:
            self.fail(
                f"{trouble} (after {here} recoveries on the way to this goal, the most allowed)"
            )
            return
        what = sequence[self._tries % len(sequence)]
        instead = None
        if what == "give way":
            instead = give_way(self.goal, seen, self.patience.behavior_s)
        elif what == "go near":
            instead = go_near(self.goal, seen, self.patience.behavior_s)
            what = "look around" if instead is None else what
        self._tries += 1
        self.recoveries += 1
        self._sequence, self._trouble = sequence, trouble
        self._attempt = f"{what} ({self._tries} of {most}): {trouble}"
        if what == "explore":
            self.explores_m = min(_EXPLORES_M * 2.0**self._explorations, _EXPLORES_MOST_M)
            self._explorations += 1
        behavior = BEHAVIOR[what]
        if behavior == NavCommand.FOLLOW and instead is None:
            behavior = NavCommand.STAND
        self._want(now_s, NavigationStatus.RECOVERING, behavior, self._attempt)
        self.instead = instead

    def _sure(self, seen: Seen) -> bool:
        """Whether the pose is so sure that a goal counts as reached."""
        return seen.health is not None and seen.health.health >= self.patience.sure_health

    def _want(self, now_s: float, state: int, behavior: int, reason: str) -> None:
        self.state, self.behavior, self.reason = state, behavior, reason
        self.instead = None
        self.goal_id = self.next_goal_id()
        self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        self._since_s = self._sure_s = self._progress_s = now_s
        self._running_s = self._moving_s = now_s

    def _end(self, state: int, reason: str) -> None:
        self.state, self.behavior, self.reason = state, NavCommand.STAND, reason
        self.instead = None
        self.goal_id = self.next_goal_id()

    def _doubt(self, now_s: float, seen: Seen) -> str:
        """Why the robot's pose cannot be relied on; empty if it can."""
        health, silent_s = seen.health, now_s - seen.health_s
        if health is None:
            return "the localizer has told nothing yet"
        if silent_s > self.patience.silent_s:
            return f"nothing was heard of the localizer for {silent_s:.1f} s"
        if health.located and health.health >= self.patience.least_health:
            return ""
        return health.reason or f"the health of the pose is {health.health:.2f}"
