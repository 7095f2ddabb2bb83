"""The grid map of a graph: drawn while driving, and corrected when poses change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.keyframes import Keyframe
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose, apart
from cairn.planar.renewals import Renewals
from cairn.planar.scan_grid import ScanGrid

Array = NDArray[np.float64]

# A scan is drawn again when its pose has changed by more than this [m], [rad]: less than a cell.
_MOVED_M, _MOVED_RAD = 0.02, 0.006


class MapGrid:
    """The grid map of keyframes, each drawn at the pose that was known at that time."""

    def __init__(self, resolution: float, reach: float) -> None:
        """Make an empty map with cells of `resolution` [m] of rays up to `reach` [m]."""
        self._counts = ScanGrid(resolution, reach)
        self._drawn: dict[int, Pose] = {}

    @property
    def counts(self) -> ScanGrid:
        """The ends and passages of rays."""
        return self._counts

    def renew(self, renewals: Renewals) -> None:
        """Draw in renewed places only keyframes from their version on, see `ScanGrid.renew`."""
        self._counts.renew(renewals)

    def update(
        self,
        keyframes: Sequence[Keyframe],
        poses: Array,
        shown: NDArray[np.bool_],
        most: int | None = None,
    ) -> bool:
        """Draw new keyframes, and again those whose poses have changed.

        Args:
            keyframes: of the graph.
            poses: (n, 3) of the keyframes.
            shown: which of them (n,) belong to the map; others are removed from it.
            most: scans that are drawn at most; the others follow in later calls. None: all.

        Returns:
            Whether anything was drawn. Raises `ValueError` if the map became too large.

        """
        left = len(keyframes) if most is None else most
        drew = False
        for number in range(len(keyframes) - 1, -1, -1):
            rays, version = keyframes[number].rays, keyframes[number].version
            if rays is None or left == 0:
                continue
            drawn = self._drawn.get(number)
            x, y, theta = poses[number].tolist()
            if drawn is not None:
                if shown[number] and not apart(drawn, (x, y, theta), _MOVED_M, _MOVED_RAD):
                    continue
                self._counts.remove(drawn, rays.rays(), version)
                del self._drawn[number]
            elif not shown[number]:
                continue
            if shown[number]:
                self._counts.add((x, y, theta), rays.rays(), version)
                self._drawn[number] = (x, y, theta)
            left -= 1
            drew = True
        return drew

    def grid(self) -> OccupancyCells:
        """Return the map; raises `ValueError` while nothing is drawn."""
        return self._counts.grid()
