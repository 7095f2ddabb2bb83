"""Selects the recovery behavior to try next when the robot cannot proceed, and where it goes.

Motion control carries it out (`motion_control/behaviors.py`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cairn.components.automove.inputs import MissionInputs
from cairn.planar.poses import Pose, distance
from cairn.schemas.cairn_nav_msgs import NavCommand

# The recovery behaviors in the order in which they are tried, by the cause: the robot does not know
# where it is; it is at its goal, but not sure of that; it does not move; no path leads to its goal.
# Without a path, waiting may help, or giving way to a person for whom the robot is in the way, or
# going near, to see whether the obstacle still stands, or looking around until the map has
# forgotten a person who stood there and has left.
WHEN_LOST = ("wait", "look around", "explore", "look around", "explore", "look around")
WHEN_UNSURE = ("look around", "explore", "look around")
WHEN_STUCK = ("wait", "look around", "back off", "give way", "look around", "wait")
WHEN_NO_PATH = ("wait", "give way", "go near", "look around")
_COMMANDS = {
    "wait": NavCommand.STAND,
    "look around": NavCommand.LOOK_AROUND,
    "explore": NavCommand.EXPLORE,
    "back off": NavCommand.BACK_OFF,
    "give way": NavCommand.FOLLOW,
    "go near": NavCommand.FOLLOW,
}

# A retreat that would be longer than this [m] is given up: obstacles have made the way back longer
# than the 1.3 m of trail that it follows.
_LONGEST_RETREAT_M = 1.8
# From a position nearer than this [m] the robot sees no more of its goal than from where it is.
_LEAST_APPROACH_M = 1.0
# Time allowed for each meter of straight line to an alternative goal [s/m], beside the time that
# any recovery has: the robot's usual 0.4 m/s, on a path of twice the straight line.
_SECONDS_PER_METER = 5.0


@dataclass(frozen=True)
class MissionLimits:
    """Limits of one mission: numbers of recoveries [1], healths of the pose [1], times [s].

    The first five are parameters of AutoMove. `unsure_s`: how long the health may be low before the
    robot stops. `unlocated_s`, `blocked_s`, `stuck_s`, `planning_s`: how long the robot may be
    unlocated, blocked, without progress, without a plan before it recovers. `waiting_s`: how long
    "wait" waits. `behavior_s`: the longest recovery; turning around once takes 8 s, exploring 8 m
    at 0.4 m/s takes 20 s. `silent_s`: the age from which an input is missing; motion control and
    localizer publish five times a second or more often. The other times were chosen by hand; half
    and double were not compared.
    """

    recoveries: int = 6
    recoveries_per_goal: int = 30
    least_health: float = 0.3
    sure_health: float = 0.5
    stopped_s: float = 15.0
    unsure_s: float = 1.0
    unlocated_s: float = 2.0
    blocked_s: float = 3.0
    stuck_s: float = 20.0
    planning_s: float = 10.0
    waiting_s: float = 4.0
    behavior_s: float = 30.0
    silent_s: float = 2.0

    def most_tries(self, sequence: Sequence[str]) -> int:
        """Return how many recoveries without progress are tried for a cause."""
        if sequence in (WHEN_LOST, WHEN_UNSURE):
            return 2 * self.recoveries  # where places look alike, a unique one may be far
        if sequence is WHEN_NO_PATH:
            return min(self.recoveries, len(sequence))
        return self.recoveries


@dataclass(frozen=True)
class AlternativeGoal:
    """A pose to drive to instead of the goal, the longest path [m], and the longest time [s]."""

    pose: Pose
    longest_m: float
    longest_s: float


@dataclass(frozen=True)
class RecoveryBehavior:
    """One recovery: its name, `NavCommand.behavior`, and where to drive for it, if anywhere."""

    name: str
    command: int
    alternative: AlternativeGoal | None = None


def choose_recovery(
    sequence: Sequence[str], tries: int, goal: Pose, inputs: MissionInputs, longest_s: float
) -> RecoveryBehavior:
    """Return what to try after `tries` recoveries of a sequence have not helped.

    Args:
        sequence: One of the sequences above.
        tries: How many recoveries were tried without progress.
        goal: The goal of the mission, in frame map.
        inputs: Where the robot is and was, and what the planner answered.
        longest_s: The longest time that a recovery may take [s].

    """
    name = sequence[tries % len(sequence)]
    alternative = None
    if name == "give way":
        alternative = _retreat(goal, inputs, longest_s)
        if alternative is None:
            return RecoveryBehavior(name, NavCommand.STAND)
    elif name == "go near":
        alternative = _approach(goal, inputs, longest_s)
        if alternative is None:
            name = "look around"
    return RecoveryBehavior(name, _COMMANDS[name], alternative)


def _retreat(goal: Pose, inputs: MissionInputs, longest_s: float) -> AlternativeGoal | None:
    """Back to where the robot came from; None if it has not come from anywhere."""
    pose = inputs.trail.retreat(goal)
    return None if pose is None else AlternativeGoal(pose, _LONGEST_RETREAT_M, longest_s)


def _approach(goal: Pose, inputs: MissionInputs, longest_s: float) -> AlternativeGoal | None:
    """To the reachable position nearest to the goal; None if there is none, or it is near."""
    if inputs.pose is None or inputs.plan is None or math.isnan(inputs.plan.nearest_x):
        return None
    x, y = inputs.plan.nearest_x, inputs.plan.nearest_y
    pose = x, y, math.atan2(goal[1] - y, goal[0] - x)
    apart = distance(inputs.pose, pose)
    if apart < _LEAST_APPROACH_M:
        return None
    return AlternativeGoal(pose, math.inf, longest_s + _SECONDS_PER_METER * apart)
