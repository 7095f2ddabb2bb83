"""What AutoMove knows of the robot: the last inputs, and the trail of positions behind it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from cairn.planar.poses import Pose, distance
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, MotionStatus, Plan

# The trail keeps positions this far apart [m], and so many of them: 5 m, well beyond the 1.3 m of a
# retreat. A pose that leaps farther [m] was corrected, as nothing drives 0.5 m between two
# estimates; the robot was not at the positions before it.
_SPACING_M, _MOST_POSITIONS, _LEAP_M = 0.1, 50, 0.5
# A retreat aims so far back [m]: three diameters of the robot (0.44 m), so that a person gets past;
# a retreat of about one diameter would not help and is not made.
_RETREAT_M, _LEAST_RETREAT_M = 1.3, 0.5


class Trail:
    """The last positions of the robot, in frame map."""

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque(maxlen=_MOST_POSITIONS)

    def add(self, pose: Pose) -> None:
        """Add the robot's pose, if it is far enough from the last one."""
        moved = distance(self._poses[-1], pose) if self._poses else _SPACING_M
        if moved > _LEAP_M:
            self._poses.clear()
        if moved >= _SPACING_M:
            self._poses.append(pose)

    def retreat(self, goal: Pose) -> Pose | None:
        """Return the last pose that is far enough behind, else the farthest; None if all are near.

        There the robot faces its goal, so that it sees when the way is free again.
        """
        farthest_m, farthest = 0.0, None
        for pose in reversed(self._poses):
            apart = distance(pose, self._poses[-1])
            if apart > farthest_m:
                farthest_m, farthest = apart, pose
            if farthest_m >= _RETREAT_M:
                break
        if farthest is None or farthest_m < _LEAST_RETREAT_M:
            return None
        x, y, _ = farthest
        return x, y, math.atan2(goal[1] - y, goal[0] - x)


@dataclass
class MissionInputs:
    """The last message of each input, and when it was received [s]; None before the first."""

    localization: LocalizationEstimate | None = None
    localization_s: float = -math.inf
    plan: Plan | None = None
    motion: MotionStatus | None = None
    motion_s: float = -math.inf
    pose: Pose | None = None
    trail: Trail = field(default_factory=Trail)

    def set_pose(self, pose: Pose) -> None:
        """Set where the robot is, in frame map."""
        self.pose = pose
        self.trail.add(pose)
