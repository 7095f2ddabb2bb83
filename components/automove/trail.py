"""Where the robot came from, so that it can go back there to give way."""

from __future__ import annotations

import math
from collections import deque

from cairn.planar.poses import Pose, distance

# Places so far apart are kept [m], and so many [1]; a pose that leaps farther [m] was corrected:
# what lies before it are not the places where the robot was.
_SPACING_M, _PLACES, _LEAP_M = 0.1, 50, 0.5
# So far [m] it goes back to give way; not at all if it came from nearer than the least.
_BACK_M, _LEAST_M = 1.3, 0.5


class Trail:
    """The last places of the robot, in frame map."""

    def __init__(self) -> None:
        self._places: deque[Pose] = deque(maxlen=_PLACES)

    def note(self, pose: Pose) -> None:
        """Note where the robot is."""
        gone = distance(self._places[-1], pose) if self._places else _SPACING_M
        if gone > _LEAP_M:
            self._places.clear()
        if gone >= _SPACING_M:
            self._places.append(pose)

    def back(self, goal: Pose) -> Pose | None:
        """The last place that is far enough from here, else the farthest; None if all are near.

        There the robot faces its goal, to see when the way is free again.
        """
        far = 0.0
        farthest = None
        for place in reversed(self._places):
            apart = distance(place, self._places[-1])
            if apart > far:
                far, farthest = apart, place
            if far >= _BACK_M:
                break
        if farthest is None or far < _LEAST_M:
            return None
        x, y, _ = farthest
        return x, y, math.atan2(goal[1] - y, goal[0] - x)
