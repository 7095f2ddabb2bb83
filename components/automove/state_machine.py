"""The mission state machine: localize, plan and drive to each goal of a mission, and recover."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from cairn.components.automove.inputs import MissionInputs
from cairn.components.automove.recovery_selection import (
    WHEN_LOST,
    WHEN_NO_PATH,
    WHEN_STUCK,
    WHEN_UNSURE,
    AlternativeGoal,
    MissionLimits,
    choose_recovery,
)
from cairn.planar.poses import Pose, distance
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    NO_REASON,
    PLAN_REASON_CODES,
    MotionStatus,
    NavCommand,
    NavigationStatus,
    Plan,
    Reason,
    ReasonCode,
)
from cairn.schemas.unique_identifier_msgs.msg import UUID

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

# The robot makes progress when it is nearer to its goal than ever before by this [m]: more than a
# correction of the pose changes the distance.
_PROGRESS_M = 0.3
# A path longer by this [m] than what was left is another path: no recovery moves the robot back so
# far along the same one. Only so many longer paths to a goal count [1], or a robot sent back and
# forth between two blocked paths would seem to make progress forever.
_DETOUR_M, _MOST_DETOURS = 2.0, 10
# The first exploration drives this far [m], each further one twice as far, up to the most: where
# positions look alike, it takes some way until one of them stands out.
_EXPLORE_M, _MOST_EXPLORE_M = 2.0, 8.0

# A person has stopped the robot, drives it, or must lead it out of a keepout zone.
_WAITED_FOR = frozenset(
    {ReasonCode.EMERGENCY_STOP, ReasonCode.OPERATOR_DRIVES, ReasonCode.IN_KEEPOUT}
)


@dataclass(kw_only=True)
class Mission:
    """What all missions have; the robot stands at first.

    Call `step` periodically with the last inputs. Afterwards `command_id`, `behavior` and `target`
    are the command for the planner and motion control, and `state` and `reason` are the mission's
    status. Each new command has a new `command_id`, from `next_command_id`.
    """

    mission_id: int
    next_command_id: Callable[[], int]
    started_s: float
    goal_id: UUID = field(default_factory=UUID)
    limits: MissionLimits = field(default_factory=MissionLimits)
    state: int = NavigationStatus.LOADING
    reason: Reason = NO_REASON
    recoveries: int = 0
    behavior: int = NavCommand.STAND
    command_id: int = field(init=False)
    goal_index: int = 0

    def __post_init__(self) -> None:
        """Start with the first command."""
        self.command_id = self.next_command_id()

    @property
    def finished(self) -> bool:
        """Whether the mission has its result."""
        return self.state in NAVIGATION_END_STATES

    def cancel(self) -> None:
        """End the mission as canceled."""
        self._end(NavigationStatus.CANCELED, Reason(ReasonCode.CANCELED, "on request"))

    def fail(self, reason: Reason) -> None:
        """End the mission as failed."""
        self._end(NavigationStatus.FAILED, reason)

    def _end(self, state: int, reason: Reason) -> None:
        self.state, self.behavior, self.reason = state, NavCommand.STAND, reason
        self.command_id = self.next_command_id()


@dataclass(kw_only=True)
class MissionStateMachine(Mission):
    """A mission to goals (waypoints in frame map), with the index of the current one."""

    goals: Sequence[Pose]
    alternative: AlternativeGoal | None = None
    """Where the robot drives to instead of its goal while it gives way or goes near."""
    explore_m: float = _EXPLORE_M
    # Counts [1]: recoveries without progress; recoveries before this goal; for this goal, longer
    # paths and explorations.
    _tries: int = 0
    _recoveries_before: int = 0
    _detours: int = 0
    _explorations: int = 0
    _sequence: Sequence[str] = ()
    _cause: Reason = NO_REASON
    _attempt: Reason = NO_REASON
    # The least distance that was left to this goal on the current path [m].
    _least_left_m: float = math.inf
    # The last time [s] of: a new state; a reliable pose; progress; motion control running; moving.
    _entered_s: float = field(init=False)
    _reliable_s: float = field(init=False)
    _progress_s: float = field(init=False)
    _running_s: float = field(init=False)
    _moving_s: float = field(init=False)

    def __post_init__(self) -> None:
        """Start with the first command and all timers."""
        super().__post_init__()
        self._restart_timers(self.started_s)

    @property
    def goal(self) -> Pose:
        """The current goal, or the last one."""
        return self.goals[min(self.goal_index, len(self.goals) - 1)]

    @property
    def distance(self) -> float:
        """How far to explore [m]."""
        return self.explore_m

    @property
    def angle(self) -> float:
        """0: no command turns by an angle."""
        return 0.0

    @property
    def speed(self) -> float:
        """0: as usual."""
        return 0.0

    @property
    def target(self) -> Pose:
        """The pose to plan to now: the goal, or an alternative during a recovery."""
        return self.goal if self.alternative is None else self.alternative.pose

    def on_plugins_loaded(self, now_s: float) -> None:
        """Localize the robot, as all plugins are loaded."""
        self.state, self.reason = NavigationStatus.LOCALIZING, NO_REASON
        self._restart_timers(now_s)

    def distance_left(self, inputs: MissionInputs) -> float:
        """Return the distance to the goal [m]: along the path, or straight if none is followed."""
        motion = inputs.motion
        # Without a path, motion control states no distance.
        if (
            self.state == NavigationStatus.DRIVING
            and motion is not None
            and motion.command_id == self.command_id
            and motion.distance_left > 0.0
        ):
            return motion.distance_left
        return distance(inputs.pose, self.goal) if inputs.pose is not None else 0.0

    def step(self, now_s: float, inputs: MissionInputs) -> None:
        """Decide on state and command at `now_s` [s]."""
        if self.finished or self.state == NavigationStatus.LOADING:
            return
        doubt = self._doubt(now_s, inputs)
        if doubt is None or now_s - inputs.localization_s > self.limits.silent_s:
            # Motion control stops for missing inputs, and names them.
            self._reliable_s = now_s
        if self.state == NavigationStatus.LOCALIZING:
            self._localize(now_s, inputs, doubt)
        elif self.state == NavigationStatus.RECOVERING:
            self._recover(now_s, inputs, doubt)
        elif doubt is not None and now_s - self._reliable_s > self.limits.unsure_s:
            self._enter(now_s, NavigationStatus.LOCALIZING, NavCommand.STAND, doubt)
        elif self.state == NavigationStatus.PLANNING:
            self._plan(now_s, inputs)
        else:
            self._drive(now_s, inputs)

    def _localize(self, now_s: float, inputs: MissionInputs, doubt: Reason | None) -> None:
        waited = now_s - self._entered_s
        if doubt is None:
            self._enter(now_s, NavigationStatus.PLANNING, NavCommand.FOLLOW)
            return
        self.reason = doubt
        if now_s - inputs.localization_s > self.limits.silent_s:
            # A silent localizer does not come back because the robot moves.
            if waited > self.limits.stopped_s:
                self.fail(doubt)
        elif waited > self.limits.unlocated_s:
            self._start_recovery(now_s, inputs, WHEN_LOST, doubt)

    def _plan(self, now_s: float, inputs: MissionInputs) -> None:
        waited = now_s - self._entered_s
        plan = self._current_plan(inputs)
        if plan is None or plan.outcome == Plan.NOT_READY:
            self.reason = NO_REASON
            cause = Reason(ReasonCode.NO_PLAN, "the path planner has not answered")
            if plan is not None:
                self.reason = cause = Reason(ReasonCode.PLANNER_NOT_READY, plan.reason)
            if waited > self.limits.planning_s:
                self._start_recovery(now_s, inputs, WHEN_STUCK, cause)
        elif plan.outcome == Plan.FOUND:
            self.state, self.reason = NavigationStatus.DRIVING, NO_REASON
            self._restart_timers(now_s)
        elif plan.outcome in (Plan.OUTSIDE_MAP, Plan.GOAL_IMPOSSIBLE, Plan.GOAL_IN_KEEPOUT):
            self.fail(_no_path(plan))
        elif plan.outcome == Plan.START_IN_KEEPOUT:
            self.reason = Reason(ReasonCode.IN_KEEPOUT, plan.reason)
        else:
            self.reason = _no_path(plan)
            if waited > self.limits.blocked_s:
                hemmed_in = plan.outcome == Plan.START_BLOCKED
                sequence = WHEN_STUCK if hemmed_in else WHEN_NO_PATH
                self._start_recovery(now_s, inputs, sequence, self.reason)

    def _drive(self, now_s: float, inputs: MissionInputs) -> None:
        motion = self._running_motion(now_s, inputs)
        if motion is None:
            return
        if motion.state == MotionStatus.DONE:
            self._arrive(now_s, inputs)
            return
        if motion.distance_left > 0.0:
            self._note_progress(now_s, motion.distance_left)
        plan = self._current_plan(inputs)
        if plan is not None and plan.outcome == Plan.GOAL_IN_KEEPOUT:
            self.fail(_no_path(plan))
            return
        if motion.state == MotionStatus.MOVING:
            self._moving_s = now_s
            self.reason = NO_REASON
            if now_s - self._progress_s > self.limits.stuck_s:
                cause = Reason(
                    ReasonCode.NO_PROGRESS, "the robot moves but does not get nearer to its goal"
                )
                self._start_recovery(now_s, inputs, WHEN_STUCK, cause)
            return
        if plan is not None and plan.outcome != Plan.FOUND:
            self.reason = _no_path(plan)
        else:
            self.reason = Reason(motion.reason_code, motion.reason)
        if now_s - self._moving_s > self.limits.blocked_s:
            self._start_recovery(now_s, inputs, WHEN_STUCK, self.reason)

    def _arrive(self, now_s: float, inputs: MissionInputs) -> None:
        """Go on to the next goal, unless the pose is too uncertain for the goal to count."""
        if not self._sure(inputs):
            code, why = int(ReasonCode.UNCONFIRMED), ""
            if inputs.localization is not None:
                code, why = inputs.localization.reason_code, inputs.localization.reason
            cause = Reason(code, f"at the goal, but the pose is uncertain: {why}")
            self._start_recovery(now_s, inputs, WHEN_UNSURE, cause)
            return
        self._tries = self._detours = self._explorations = 0
        self._recoveries_before, self._least_left_m = self.recoveries, math.inf
        x, y, _ = self.goal
        self.goal_index += 1
        if self.goal_index >= len(self.goals):
            arrived = Reason(ReasonCode.ARRIVED, f"arrived at ({x:.2f}, {y:.2f})")
            self._end(NavigationStatus.SUCCEEDED, arrived)
        else:
            self._enter(now_s, NavigationStatus.PLANNING, NavCommand.FOLLOW)

    def _note_progress(self, now_s: float, left_m: float) -> None:
        """Restart the count of tries where less is left than ever, on whichever path.

        To drive again what a recovery has undone is not progress, or a robot that backs off from an
        obstacle and approaches it again would never give up. But a path around the obstacle may be
        much longer than what was left: to proceed along it is progress, even though the robot has
        been nearer to its goal before.
        """
        if left_m > self._least_left_m + _DETOUR_M and self._detours < _MOST_DETOURS:
            self._detours += 1
            self._least_left_m, self._progress_s = left_m, now_s
        elif left_m < self._least_left_m - _PROGRESS_M:
            if self._least_left_m < math.inf:
                self._tries = 0
            self._least_left_m, self._progress_s = left_m, now_s

    def _running_motion(self, now_s: float, inputs: MissionInputs) -> MotionStatus | None:
        """Return the status of motion control, None if it cannot work; fail if that lasts."""
        motion = inputs.motion
        silent_s = now_s - inputs.motion_s
        if silent_s > self.limits.silent_s and motion is not None:
            self.reason = Reason(
                ReasonCode.NO_MOTION_STATUS, f"no status from motion control for {silent_s:.1f} s"
            )
        elif motion is None or motion.command_id != self.command_id:
            self.reason = Reason(ReasonCode.NO_MOTION_STATUS, "motion control has not answered yet")
        elif motion.state == MotionStatus.STOPPED:
            self.reason = Reason(motion.reason_code, motion.reason)
        else:
            self._running_s = now_s
            return motion
        self._moving_s = now_s
        if self.reason.code in _WAITED_FOR and silent_s <= self.limits.silent_s:
            # The goal waits for the person as long as that takes.
            self._running_s = self._progress_s = now_s
        if now_s - self._running_s > self.limits.stopped_s:
            self.fail(self.reason)
        return None

    def _recover(self, now_s: float, inputs: MissionInputs, doubt: Reason | None) -> None:
        waited = now_s - self._entered_s
        if self.behavior == NavCommand.STAND:
            ended = waited > self.limits.waiting_s
        elif self.alternative is not None:
            if doubt is not None or self._alternative_ended(now_s, inputs, self.alternative):
                stand = NavCommand.STAND
                self._enter(now_s, NavigationStatus.RECOVERING, stand, self._attempt)
            return
        else:
            motion = self._running_motion(now_s, inputs)
            if motion is None:
                return
            self.reason = self._attempt
            ended = motion.state in (MotionStatus.DONE, MotionStatus.BLOCKED)
            ended = ended or waited > self.limits.behavior_s
        # The recovery of a robot that was lost ends as soon as the robot is located again.
        located = self._sequence is WHEN_LOST and doubt is None
        located = located or (self._sequence is WHEN_UNSURE and self._sure(inputs))
        if ended or (located and waited > self.limits.unsure_s):
            self._enter(now_s, NavigationStatus.LOCALIZING, NavCommand.STAND, self._cause)

    def _alternative_ended(
        self, now_s: float, inputs: MissionInputs, alternative: AlternativeGoal
    ) -> bool:
        """Whether the robot is at the alternative goal, or cannot get there soon."""
        plan = self._current_plan(inputs)
        if plan is not None and (plan.outcome != Plan.FOUND or plan.length > alternative.longest_m):
            return True
        motion = self._running_motion(now_s, inputs)
        if motion is None:
            return False
        self.reason = self._attempt
        if motion.state == MotionStatus.MOVING:
            self._moving_s = now_s
        blocked = now_s - self._moving_s > self.limits.unsure_s
        too_long = now_s - self._entered_s > alternative.longest_s
        return motion.state == MotionStatus.DONE or blocked or too_long

    def _start_recovery(
        self, now_s: float, inputs: MissionInputs, sequence: Sequence[str], cause: Reason
    ) -> None:
        """Start the next recovery behavior of a sequence, or fail if there were too many."""
        most = self.limits.most_tries(sequence)
        if self._tries >= most:
            tried = f" (after {self._tries} recoveries)" if self._tries else ""
            self.fail(Reason(cause.code, cause.text + tried))
            return
        for_goal = self.recoveries - self._recoveries_before
        if for_goal >= self.limits.recoveries_per_goal:
            tried = f" (after {for_goal} recoveries for this goal, the most allowed)"
            self.fail(Reason(cause.code, cause.text + tried))
            return
        recovery = choose_recovery(sequence, self._tries, self.goal, inputs, self.limits.behavior_s)
        self._tries += 1
        self.recoveries += 1
        self._sequence, self._cause = sequence, cause
        self._attempt = Reason(
            cause.code, f"{recovery.name} ({self._tries} of {most}): {cause.text}"
        )
        if recovery.command == NavCommand.EXPLORE:
            self.explore_m = min(_EXPLORE_M * 2.0**self._explorations, _MOST_EXPLORE_M)
            self._explorations += 1
        self._enter(now_s, NavigationStatus.RECOVERING, recovery.command, self._attempt)
        self.alternative = recovery.alternative

    def _current_plan(self, inputs: MissionInputs) -> Plan | None:
        plan = inputs.plan
        return plan if plan is not None and plan.command_id == self.command_id else None

    def _sure(self, inputs: MissionInputs) -> bool:
        """Whether the pose is so reliable that a goal counts as reached."""
        estimate = inputs.localization
        return estimate is not None and estimate.health >= self.limits.sure_health

    def _doubt(self, now_s: float, inputs: MissionInputs) -> Reason | None:
        """Return why the robot's pose cannot be relied on; None if it can."""
        estimate, silent_s = inputs.localization, now_s - inputs.localization_s
        if estimate is None:
            return Reason(ReasonCode.NO_LOCALIZATION, "no estimate from the localizer yet")
        if silent_s > self.limits.silent_s:
            return Reason(
                ReasonCode.NO_LOCALIZATION, f"no estimate from the localizer for {silent_s:.1f} s"
            )
        if estimate.located and estimate.health >= self.limits.least_health:
            return None
        words = estimate.reason or f"the health of the pose is {estimate.health:.2f}"
        return Reason(estimate.reason_code, words)

    def _enter(self, now_s: float, state: int, behavior: int, reason: Reason = NO_REASON) -> None:
        """Enter a state with a new command."""
        self.state, self.behavior, self.reason = state, behavior, reason
        self.alternative = None
        self.command_id = self.next_command_id()
        self._restart_timers(now_s)

    def _restart_timers(self, now_s: float) -> None:
        self._entered_s = self._reliable_s = self._progress_s = now_s
        self._running_s = self._moving_s = now_s

    def _end(self, state: int, reason: Reason) -> None:
        super()._end(state, reason)
        self.alternative = None


def _no_path(plan: Plan) -> Reason:
    return Reason(PLAN_REASON_CODES[plan.outcome], f"no path: {plan.reason}")


_COMMAND_ID_MODULUS = 2**32
_NS_PER_MS = 1_000_000


class CommandIds:
    """Creates ids of commands that increase, and none that an earlier process of AutoMove has used.

    An id is the time in milliseconds [mod 2^32], or the last id plus one if that is larger; 0 means
    that there is no command. So the ids of an earlier process are all smaller, unless it used more
    than a thousand a second.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def next(self, now: int) -> int:
        """Return the id of a command that starts at `now` [ns]."""
        command_id = now // _NS_PER_MS % _COMMAND_ID_MODULUS
        if self._last is not None:
            following = (self._last + 1) % _COMMAND_ID_MODULUS
            if (command_id - following) % _COMMAND_ID_MODULUS >= _COMMAND_ID_MODULUS // 2:
                command_id = following
        self._last = command_id or 1
        return self._last
