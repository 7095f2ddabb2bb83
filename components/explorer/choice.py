"""The choice of the next frontier, and the count of tries at frontiers that do not disappear."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cairn.components.explorer.frontiers import Frontier

# Frontiers this near to each other [m] are the same one: after a loop closure, too, which moves
# the map by less.
SAME_M = 0.6
# Tries at a frontier until it is given up [1].
_MOST_TRIES = 3
# A wider frontier is worth a longer path: so many meters per meter of width, up to the most width
# that counts [m].
_WORTH, _MOST_WIDTH_M = 0.5, 4.0


@dataclass(frozen=True)
class _Tried:
    x: float
    y: float
    tries: int


class FrontierChoice:
    """Chooses the frontiers one after the other; remembers those that tries did not make known."""

    def __init__(self) -> None:
        self._tried: list[_Tried] = []

    def best(self, frontiers: Sequence[Frontier]) -> Frontier | None:
        """Return the frontier to drive to; None if all are given up.

        Frontiers with fewer tries come first: what blocked the way to another one may go away
        meanwhile.
        """
        left = [one for one in frontiers if self.tries(one) < _MOST_TRIES]
        return min(left, key=lambda one: (self.tries(one), _price(one)), default=None)

    def given_up(self, frontiers: Sequence[Frontier]) -> int:
        """Return how many of the frontiers are given up."""
        return sum(self.tries(one) >= _MOST_TRIES for one in frontiers)

    def tries(self, frontier: Frontier) -> int:
        """Return how many tries at a frontier have failed."""
        x, y, _ = frontier.pose
        near = (one.tries for one in self._tried if math.dist((x, y), (one.x, one.y)) <= SAME_M)
        return max(near, default=0)

    def failed(self, frontier: Frontier) -> None:
        """Count a try that did not make the frontier known."""
        x, y, _ = frontier.pose
        self._tried.append(_Tried(x, y, self.tries(frontier) + 1))


def _price(frontier: Frontier) -> float:
    return frontier.path_m - _WORTH * min(frontier.width_m, _MOST_WIDTH_M)
