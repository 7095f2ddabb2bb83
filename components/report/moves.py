"""Where an object of the visual map was taken from, and where it was found again."""

import math
from dataclasses import dataclass, field

Place = tuple[float, float]
_SAME = 0.02  # [m]: a place that agreeing sightings refined meanwhile


@dataclass
class Move:
    """One move: the place that the object left, None if the map had none, and when (int ns)."""

    left: Place | None
    removed_at: int | None
    registered_at: int | None = None


@dataclass
class Moves:
    """The moves of one object that still hold: those that the map took back are forgotten."""

    standing: list[Move] = field(default_factory=list)

    @property
    def last(self) -> Move:
        """The last move; one without times if the object never moved."""
        return self.standing[-1] if self.standing else Move(None, None)

    def removed(self, stamp: int, left: Place | None) -> None:
        """The object was removed from a place."""
        self.standing.append(Move(left, stamp))

    def registered(self, stamp: int) -> None:
        """The object was registered at a new place."""
        if not self.standing or self.standing[-1].registered_at is not None:
            self.standing.append(Move(None, None))
        self.standing[-1].registered_at = stamp

    def restored(self, place: Place | None) -> None:
        """The object stands again at a place that it left; None: it is again sought for."""
        if place is None:
            if self.standing and self.standing[-1].registered_at is None:
                self.standing.pop()
            if self.standing:
                self.standing[-1].registered_at = None
            return
        while self.standing:
            left = self.standing.pop().left
            if left is None or math.dist(left, place) <= _SAME:
                return
