"""Undoes changes of the maps after the robot turned out to be lost (kidnapped)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.visual_map.landmarks import LandmarkRecord, LandmarkState

MOST_ENTRIES: Final = 10_000
"""Judgments that can be undone: 80 in each second of the longest time, far more than there are."""


@dataclass(frozen=True)
class _LandmarkUndo:
    at_s: float
    before: LandmarkRecord


class LandmarkJournal:
    """The landmarks as they were before they lost trust, in the last `kept_s` seconds."""

    def __init__(self, kept_s: float) -> None:
        self._kept_s = kept_s
        self._entries: deque[_LandmarkUndo] = deque(maxlen=MOST_ENTRIES)

    def forget_old(self, now_s: float) -> None:
        """Remove entries that are older than `kept_s`."""
        while self._entries and self._entries[0].at_s < now_s - self._kept_s:
            self._entries.popleft()

    def record(self, now_s: float, before: LandmarkRecord, after: LandmarkRecord) -> None:
        """Record a change of a landmark, if it lost trust by it."""
        if _lost_trust(before, after):
            self._entries.append(_LandmarkUndo(now_s, before))

    def forget(self, object_id: int) -> None:
        """Remove the entries about a landmark, which can no longer be undone."""
        kept = [one for one in self._entries if one.before.object_id != object_id]
        self._entries = deque(kept, maxlen=MOST_ENTRIES)

    def undo(self, since_s: float) -> dict[int, LandmarkRecord]:
        """Remove the entries after `since_s` [s]; return the landmarks as they were then."""
        restored: dict[int, LandmarkRecord] = {}
        while self._entries and self._entries[-1].at_s > since_s:
            before = self._entries.pop().before
            restored[before.object_id] = before
        return restored


@dataclass(frozen=True)
class GridWindow:
    """A part of a grid map that begins at `row` and `column`; `values` (rows, columns)."""

    row: int
    column: int
    values: NDArray[np.int8]

    @property
    def rows(self) -> slice:
        """Return the rows of the map that it covers."""
        return slice(self.row, self.row + self.values.shape[0])

    @property
    def columns(self) -> slice:
        """Return the columns of the map that it covers."""
        return slice(self.column, self.column + self.values.shape[1])

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Return the first row and column, and those after the last."""
        return self.rows.start, self.columns.start, self.rows.stop, self.columns.stop


@dataclass(frozen=True)
class _GridUndo:
    """Flat indices of the cells that changed, and their former values."""

    stamp_s: float
    cells: NDArray[np.int32]
    values: NDArray[np.int8]


class GridJournal:
    """The changes of a map's `cells` in the last `kept_s` seconds."""

    def __init__(self, cells: NDArray[np.int8], kept_s: float) -> None:
        self._kept_s = kept_s
        self._cells = cells
        self._before = cells.copy()
        self._changes: deque[_GridUndo] = deque()

    def record(self, stamp_s: float, window: GridWindow) -> None:
        """Record the changes in `window` at `stamp_s` [s]; forget old ones."""
        while self._changes and self._changes[0].stamp_s < stamp_s - self._kept_s:
            self._changes.popleft()
        before = self._before[window.rows, window.columns]
        rows, columns = np.nonzero(before != window.values)
        changed = (window.row + rows) * self._cells.shape[1] + window.column + columns
        self._changes.append(_GridUndo(stamp_s, changed.astype(np.int32), before[rows, columns]))
        before[:] = window.values

    def forget(self, cells: NDArray[np.int64]) -> None:
        """Forget the changes of `cells` (flat indices), so that they are not undone."""
        self._before.flat[cells] = self._cells.flat[cells]
        kept = []
        for change in self._changes:
            stays = np.isin(change.cells, cells, invert=True)
            kept.append(_GridUndo(change.stamp_s, change.cells[stays], change.values[stays]))
        self._changes = deque(kept)

    def undo(self, stamp_s: float) -> GridWindow | None:
        """Restore the map of `stamp_s` [s]; return the window that this changes."""
        undone = []
        while self._changes and self._changes[-1].stamp_s >= stamp_s:
            change = self._changes.pop()
            self._cells.flat[change.cells] = change.values
            self._before.flat[change.cells] = change.values
            undone.append(change.cells)
        cells = np.concatenate(undone) if undone else np.zeros(0, np.int32)
        if not cells.size:
            return None
        rows, columns = np.divmod(cells, self._cells.shape[1])
        top, left = int(rows.min()), int(columns.min())
        values = self._cells[top : rows.max() + 1, left : columns.max() + 1]
        return GridWindow(top, left, values.copy())


def _lost_trust(before: LandmarkRecord, after: LandmarkRecord) -> bool:
    return (
        after.reliability < before.reliability
        or after.state is not before.state
        or (after.state is LandmarkState.RELOCATING and after.candidate != before.candidate)
    )
