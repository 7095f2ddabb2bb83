"""From where an object is usually recognized, and so from where it is missed when it is gone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from cairn.planar.poses import Pose

Cell = tuple[int, int]

# A cell is a direction from the object to the robot, and a distance between them.
_SECTORS = 12
_BAND_M = 1.0
# Counts are halved beyond this, so that what holds now outweighs what was long ago.
_MOST = 64
# An object that was recognized less often than this from a cell is not expected to be again.
_KNOWN_FROM = 3
# Chance to recognize an object that is not there.
_FALSE = 0.02
# One absence never says more than this: what hides an object at one moment does so at the next.
_LEAST_SIMILARITY = 0.3


@dataclass(frozen=True)
class Viewpoints:
    """How often an object was `seen` and `missed` from each cell while it stood where it stands.

    `absent` are the cells from which it was not seen since it was last recognized: whether it was
    missed there, or gone, is not known yet.
    """

    seen: tuple[tuple[Cell, int], ...] = ()
    missed: tuple[tuple[Cell, int], ...] = ()
    absent: tuple[Cell, ...] = ()

    def recognized(self, cell: Cell) -> Viewpoints:
        """It was recognized from a cell; so it was there, and was missed before."""
        missed = dict(self.missed)
        for one in self.absent:
            missed[one] = missed.get(one, 0) + 1
        seen = dict(self.seen)
        seen[cell] = seen.get(cell, 0) + 1
        if seen[cell] > _MOST:
            seen[cell] //= 2
            missed[cell] = missed.get(cell, 0) // 2
        return Viewpoints(tuple(sorted(seen.items())), tuple(sorted(missed.items())))

    def not_seen(self, cell: Cell) -> Viewpoints:
        """It was not recognized from a cell."""
        return replace(self, absent=(*self.absent, cell))

    def similarity_of_absence(self, cell: Cell) -> float | None:
        """What not being recognized from a cell says for its place: at most 0.5, in [0, 1].

        None if it is not known to be recognized from there. The chance of missing what is there
        against that of not "recognizing" what is gone.
        """
        seen = dict(self.seen).get(cell, 0)
        if seen < _KNOWN_FROM:
            return None
        missing = 1.0 - seen / (seen + dict(self.missed).get(cell, 0) + 1.0)
        return max(_LEAST_SIMILARITY, missing / (missing + 1.0 - _FALSE))


NOWHERE = Viewpoints()


def cell_of(x: float, y: float, robot: Pose) -> Cell:
    """The cell in which the robot sees an object at x, y [m]."""
    dx, dy = robot[0] - x, robot[1] - y
    sector = math.floor((math.atan2(dy, dx) + math.pi) / (2.0 * math.pi) * _SECTORS)
    return min(sector, _SECTORS - 1), math.floor(math.hypot(dx, dy) / _BAND_M)
