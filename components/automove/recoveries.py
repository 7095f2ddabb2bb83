"""What is tried when the robot cannot get on, and how long it waits before."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.schemas.cairn_nav_msgs import NavCommand

# What is tried, one after the other, when the robot is lost; when it cannot get on; when there is
# no way to its goal, where waiting may help, or giving way to somebody for whom the robot is in the
# way, or going near, to see whether what is in the way still stands, or looking around until the
# map has forgotten somebody who stood there and has left.
WHEN_LOST = ("wait", "look around", "explore", "look around", "explore", "look around")
WHEN_UNSURE = ("look around", "explore", "look around")
WHEN_STUCK = ("wait", "look around", "back off", "give way", "look around", "wait")
WHEN_NO_WAY = ("wait", "give way", "go near", "look around")
BEHAVIOR = {
    "wait": NavCommand.STAND,
    "look around": NavCommand.LOOK_AROUND,
    "explore": NavCommand.EXPLORE,
    "back off": NavCommand.BACK_OFF,
    "give way": NavCommand.FOLLOW,
    "go near": NavCommand.FOLLOW,
}


@dataclass(frozen=True)
class Patience:
    """How long to wait for what [s], how often to recover [1], how sure to be of the pose [1]."""

    recoveries: int = 6
    recoveries_per_goal: int = 30
    least_health: float = 0.3
    sure_health: float = 0.5
    unsure_s: float = 1.0
    unlocated_s: float = 2.0
    blocked_s: float = 3.0
    stopped_s: float = 15.0
    stuck_s: float = 20.0
    planning_s: float = 10.0
    waiting_s: float = 4.0
    behavior_s: float = 30.0
    silent_s: float = 2.0
