"""Where the robot goes instead of its goal when there is no way there."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cairn.components.automove.seen import Seen
from cairn.planar.poses import Pose, distance

# What gives way goes no farther [m], though the way back may have become longer.
_MOST_BACK_M = 1.8
# What is nearer to where it can get than this [m] sees no more from there.
_NEAR_M = 1.0
# So long it may take for each meter as the crow flies [s/m], beside what any recovery may take.
_SLOWEST_S_PER_M = 5.0


@dataclass(frozen=True)
class Aside:
    """A place to go to, the longest way there [m], and the longest that it may take [s]."""

    place: Pose
    most_m: float
    most_s: float


def give_way(goal: Pose, seen: Seen, behavior_s: float) -> Aside | None:
    """Back to where it came from; None if it came from nowhere."""
    place = seen.trail.back(goal)
    return None if place is None else Aside(place, _MOST_BACK_M, behavior_s)


def go_near(goal: Pose, seen: Seen, behavior_s: float) -> Aside | None:
    """To the reachable place nearest to the goal; None if there is none, or the robot is there."""
    if seen.pose is None or seen.plan is None or math.isnan(seen.plan.nearest_x):
        return None
    x, y = seen.plan.nearest_x, seen.plan.nearest_y
    place = x, y, math.atan2(goal[1] - y, goal[0] - x)
    apart = distance(seen.pose, place)
    if apart < _NEAR_M:
        return None
    return Aside(place, math.inf, behavior_s + _SLOWEST_S_PER_M * apart)
