"""What a grid map was before its last changes, so that they can be taken back."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.map_builder.window import Window


@dataclass(frozen=True)
class _Change:
    """Cells that changed, counted row by row, and what they were."""

    stamp_s: float
    cells: NDArray[np.int32]
    values: NDArray[np.int8]


class Undo:
    """The changes of a map's `cells` in the last `kept_s` seconds."""

    def __init__(self, cells: NDArray[np.int8], kept_s: float) -> None:
        self._kept_s = kept_s
        self._cells = cells
        self._before = cells.copy()
        self._changes: deque[_Change] = deque()

    def note(self, stamp_s: float, window: Window) -> None:
        """Take what `window` has changed, at `stamp_s` [s]; forget what is too old."""
        while self._changes and self._changes[0].stamp_s < stamp_s - self._kept_s:
            self._changes.popleft()
        before = self._before[window.rows, window.columns]
        rows, columns = np.nonzero(before != window.values)
        changed = (window.row + rows) * self._cells.shape[1] + window.column + columns
        self._changes.append(_Change(stamp_s, changed.astype(np.int32), before[rows, columns]))
        before[:] = window.values

    def take_back(self, stamp_s: float) -> Window | None:
        """Make the map as it was at `stamp_s` [s]; gives what has changed by that."""
        undone = []
        while self._changes and self._changes[-1].stamp_s >= stamp_s:
            change = self._changes.pop()
            self._cells.flat[change.cells] = change.values
            self._before.flat[change.cells] = change.values
            undone.append(change.cells)
        if not undone:
            return None
        rows, columns = np.divmod(np.concatenate(undone), self._cells.shape[1])
        top, left = int(rows.min()), int(columns.min())
        values = self._cells[top : rows.max() + 1, left : columns.max() + 1]
        return Window(top, left, values.copy())
