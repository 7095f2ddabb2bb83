"""The grid map of a graph: drawn while driving, and corrected when poses change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.keyframes import Keyframe, pose_of
from cairn.planar.poses import wrap_all
from cairn.planar.scan_grid import ScanGrid

Array = NDArray[np.float64]


class MapGrid:
    """The grid map of keyframes, each drawn at the pose that was known at that time."""

    def __init__(self, resolution: float, reach: float) -> None:
        """Make an empty map with cells of `resolution` [m] of rays up to `reach` [m]."""
        self._resolution = resolution
        self.counts = ScanGrid(resolution, reach)
        """The ends and passages of rays."""
        self._drawn = np.zeros((0, 3))  # where each keyframe is drawn; NaN: nowhere
        self._far = np.zeros(0)  # the distance of its surfaces [m]

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
        new = keyframes[len(self._drawn) :]
        far = [np.sqrt(np.square(one.cloud.points).sum() / max(1, one.cloud.count)) for one in new]
        self._far = np.concatenate((self._far, far))
        self._drawn = np.concatenate((self._drawn, np.full((len(new), 3), np.nan)))
        is_drawn = ~np.isnan(self._drawn[:, 0])
        # A scan is drawn again when its surfaces have moved by half a cell.
        way = np.hypot(*(poses - self._drawn)[:, :2].T)
        way += self._far * np.abs(wrap_all(poses[:, 2] - self._drawn[:, 2]))
        moved = way > 0.5 * self._resolution
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
