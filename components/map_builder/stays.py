"""Where an object stood of late: one that is now here, now there is two that look alike."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cairn.components.map_builder.place import Place

# An object is at a place again that it has left if it is no farther than this [m] from it.
_SAME_M = 0.35
# People who carry an object to and fro seldom do it twice within this time [s].
_REMEMBERED_S = 600.0
_RETURNS = 2
# For so long [s] an object that seems to be two is not relied on.
_DOUBTED_S = 600.0


@dataclass(frozen=True)
class Stays:
    """The places [m] that an object has left, with their times [s], and how often it came back.

    Until `doubted_until_s` nothing that is seen of it counts.
    """

    left: tuple[tuple[Place, float], ...] = ()
    returns: int = 0
    doubted_until_s: float = -math.inf

    def leave(self, place: Place, now_s: float) -> Stays:
        """It was removed from a place."""
        kept = tuple((one, at) for one, at in self.left if now_s - at <= _REMEMBERED_S)
        return replace(self, left=(*kept, (place, now_s)), returns=self.returns if kept else 0)

    def come(self, place: Place, now_s: float) -> Stays:
        """It is seen to stand at a place: is that one that it has left of late?"""
        before = any(
            one.distance(place) <= _SAME_M and now_s - at <= _REMEMBERED_S
            for one, at in self.left[:-1]
        )
        if not before:
            return self
        if self.returns + 1 < _RETURNS:
            return replace(self, returns=self.returns + 1)
        return Stays(doubted_until_s=now_s + _DOUBTED_S)

    def doubted(self, now_s: float) -> bool:
        """Whether it is taken for two things that look alike."""
        return now_s < self.doubted_until_s


NONE = Stays()
