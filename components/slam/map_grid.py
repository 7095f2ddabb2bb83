"""The grid map of a graph: drawn while driving, and corrected when poses change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.keyframes import Keyframe, pose_of
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import wrap_all
from cairn.planar.renewals import Renewals
from cairn.planar.scan_grid import ScanGrid

Array = NDArray[np.float64]

# A scan is drawn again when its pose has changed by more than this [m], [rad]: less than a cell.
_MOVED_M, _MOVED_RAD = 0.02, 0.006


class MapGrid:
    """The grid map of keyframes, each drawn at the pose that was known at that time."""

    def __init__(self, resolution: float, reach: float) -> None:
        """Make an empty map with cells of `resolution` [m] of rays up to `reach` [m]."""
        self.counts = ScanGrid(resolution, reach)
        """The ends and passages of rays."""
        self._drawn = np.zeros((0, 3))  # where each keyframe is drawn; NaN: nowhere

    def renew(self, renewals: Renewals) -> None:
        """Draw in renewed places only keyframes from their version on, see `ScanGrid.renew`."""
        self.counts.renew(renewals)

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
        new = np.full((len(keyframes) - len(self._drawn), 3), np.nan)
        self._drawn = np.concatenate((self._drawn, new))
        is_drawn = ~np.isnan(self._drawn[:, 0])
        moved = np.hypot(*(poses - self._drawn)[:, :2].T) > _MOVED_M
        moved |= np.abs(wrap_all(poses[:, 2] - self._drawn[:, 2])) > _MOVED_RAD
        outdated = np.flatnonzero(np.where(is_drawn, moved | ~shown, shown))
        outdated = outdated[[keyframes[k].rays is not None for k in outdated.tolist()]]
        for number in outdated[::-1][:most].tolist():
            rays, version = keyframes[number].rays, keyframes[number].version
            assert rays is not None
            if is_drawn[number]:
                self.counts.remove(pose_of(self._drawn, number), rays.rays(), version)
                self._drawn[number] = np.nan
            if shown[number]:
                self.counts.add(pose_of(poses, number), rays.rays(), version)
                self._drawn[number] = poses[number]
        return bool(outdated[:most].size)

    def grid(self) -> OccupancyCells:
        """Return the map; raises `ValueError` while nothing is drawn."""
        return self.counts.grid()
