"""Until when a robot that turns out to be lost was where it believed to be."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from cairn.components.localizer.object_likelihood import Landmark
from cairn.components.localizer.recent import TOGETHER


class Agreements:
    """When each mapped object was last seen where a pose that did not rely on it expected it.

    Somewhere else one object may stand as expected by chance, two at different places hardly do.
    """

    def __init__(self) -> None:
        self._at: dict[int, float] = {}
        self.confirmed_until = -math.inf
        """Until when [s] the robot was certainly not lost before it was placed anew."""

    def note(self, stamp: float, objects: Iterable[int]) -> None:
        """Take which objects agreed at `stamp` [s]."""
        self._at |= dict.fromkeys(objects, stamp)

    def placed_anew(self, landmarks: Mapping[int, Landmark]) -> None:
        """Take that the robot may be somewhere else than what has agreed so far made believe."""
        self.confirmed_until = max(self.confirmed_until, self._both_since(landmarks))
        self._at.clear()

    def _both_since(self, landmarks: Mapping[int, Landmark]) -> float:
        """The latest time [s] since when objects at two places agreed; -inf if none did."""
        newest: Landmark | None = None
        for object_id, stamp in sorted(self._at.items(), key=lambda one: -one[1]):
            mark = landmarks.get(object_id)
            if mark is None:
                continue
            if newest is None:
                newest = mark
            elif math.hypot(mark.x - newest.x, mark.y - newest.y) > TOGETHER:
                return stamp
        return -math.inf
