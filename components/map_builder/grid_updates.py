"""What has changed in the grid map since it was last told."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cairn.components.map_builder.window import Window


class GridUpdates:
    """Gathers changed windows into one."""

    def __init__(self) -> None:
        self._box: tuple[int, int, int, int] | None = None
        self.untold = False

    def add(self, window: Window | None) -> None:
        """Take a window that has changed."""
        if window is None:
            return
        box = window.box
        if self._box is not None:
            top, left, bottom, right = self._box
            box = (min(top, box[0]), min(left, box[1]), max(bottom, box[2]), max(right, box[3]))
        self._box = box

    def take(self, cells: NDArray[np.int8]) -> Window | None:
        """All that changed since the last call, with the values of now; None if nothing did."""
        if self._box is None:
            return None
        top, left, bottom, right = self._box
        self._box = None
        self.untold = True
        return Window(top, left, cells[top:bottom, left:right].copy())

    def told(self) -> None:
        """The whole map was told."""
        self._box = None
        self.untold = False
