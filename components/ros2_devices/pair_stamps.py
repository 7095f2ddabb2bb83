"""Stamps of a stereo pair: those of both images become equal, by which consumers pair them."""

from __future__ import annotations

from collections import deque
from typing import Final

from cairn import SECOND

PAIR_TOLERANCE_NS: Final = SECOND // 100
"""Images of a pair differ by at most this [ns]."""

_KEPT: Final = 4  # of each side, that wait for a partner


class PairStamps:
    """Gives the second image of a pair the time of the first one.

    No image waits for another one: what has no partner keeps its own time.
    """

    def __init__(self) -> None:
        self._alone: tuple[deque[tuple[int, int]], deque[tuple[int, int]]] = (
            deque(maxlen=_KEPT),
            deque(maxlen=_KEPT),
        )

    def common(self, side: int, own: int, published: int) -> int:
        """Return the time [ns] of an image of the left (0) or the right (1) camera.

        `own` is the stamp by its node, by which images are paired, and `published` its time if it
        is the first one of a pair.
        """
        others = self._alone[1 - side]
        nearest = min(others, key=lambda other: abs(other[0] - own), default=None)
        if nearest is None or abs(nearest[0] - own) > PAIR_TOLERANCE_NS:
            self._alone[side].append((own, published))
            return published
        others.remove(nearest)
        return nearest[1]
