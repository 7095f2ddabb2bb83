"""Where an object of the visual map was taken from, and where it was found again."""

import math
from dataclasses import dataclass, field

Place = tuple[float, float]


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
        if place is not None:
            del self.standing[self._since(place) :]
            return
        if self.standing and self.standing[-1].registered_at is None:
            self.standing.pop()
        if self.standing and self.standing[-1].removed_at is None:
            self.standing.pop()
        elif self.standing:
            self.standing[-1].registered_at = None

    def _since(self, place: Place) -> int:
        """The move that left this place; sightings may have refined it by centimeters before."""
        left = [move.left for move in self.standing]
        apart = [math.inf if one is None else math.dist(one, place) for one in left]
        return min(reversed(range(len(apart))), key=apart.__getitem__, default=0)
