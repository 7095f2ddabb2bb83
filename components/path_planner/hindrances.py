"""Where motion control did not get on: told by how long the robot stays, avoided for some time."""

from __future__ import annotations

import math

from cairn import SECOND
from cairn.planar.poses import Pose, distance
from cairn.schemas.cairn_nav_msgs import MotionStatus

Place = tuple[float, float]
"""x, y [m] in frame map."""

# It does not get on when it has come no further than that [m] for so long: when it says that it is
# blocked; when it seems to move [ns].
_STAYS = 0.2
_BLOCKED, _MOVING = round(2.2 * SECOND), 6 * SECOND
# Places nearer to one another [m] are the same.
_SAME = 0.3


class Hindrances:
    """Places, and until when [ns] each is avoided where there is another way."""

    def __init__(self) -> None:
        self._places: dict[Place, int] = {}
        self._stay: tuple[int, int, Pose] | None = None  # the goal_id, since when, and where

    def is_stuck(self, now: int, status: MotionStatus, pose: Pose) -> bool:
        """Whether the robot, following a path, has not got on; counts anew once it was told."""
        if status.state not in (MotionStatus.MOVING, MotionStatus.BLOCKED):
            self._stay = None
            return False
        stay = self._stay
        if stay is None or stay[0] != status.goal_id or distance(stay[2], pose) > _STAYS:
            self._stay = status.goal_id, now, pose
            return False
        if now - stay[1] < (_BLOCKED if status.state == MotionStatus.BLOCKED else _MOVING):
            return False
        self._stay = status.goal_id, now, pose
        return True

    def add(self, place: Place, until: int) -> None:
        """Avoid a place until that time [ns]."""
        self._places = {p: t for p, t in self._places.items() if math.dist(p, place) > _SAME}
        self._places[place] = until

    def forget(self, now: int) -> None:
        """Forget what is over at that time [ns]."""
        self._places = {place: until for place, until in self._places.items() if until > now}

    def places(self) -> tuple[Place, ...]:
        """The places to avoid."""
        return tuple(self._places)
