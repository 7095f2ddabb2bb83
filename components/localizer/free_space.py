"""Where on the grid map a robot may be at all."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import FREE_TO, OccupancyCells

Array = NDArray[np.float64]


class FreeSpace:
    """The free cells of a map."""

    def __init__(self, grid: OccupancyCells) -> None:
        self._frame = grid.frame
        self._cells = np.argwhere((grid.values >= 0) & (grid.values <= FREE_TO))

    @property
    def area(self) -> float:
        """Free area [m^2]."""
        return len(self._cells) * self._frame.resolution**2

    def draw(self, count: int, random: np.random.Generator) -> Array:
        """`count` poses (3, count), uniform over the free cells and all headings."""
        poses = np.empty((3, count))
        if not len(self._cells):
            return poses[:, :0]
        chosen = self._cells[random.integers(0, len(self._cells), count)]
        along = (chosen[:, 1] + random.random(count)) * self._frame.resolution
        across = (chosen[:, 0] + random.random(count)) * self._frame.resolution
        x, y, theta = self._frame.origin
        cosine, sine = math.cos(theta), math.sin(theta)
        poses[0] = x + cosine * along - sine * across
        poses[1] = y + sine * along + cosine * across
        poses[2] = random.uniform(-math.pi, math.pi, count)
        return poses
