"""The grid map that a shared record amounts to, and what this robot decides for it.

The map is a pure function of the record and of the map from which all robots started: equal records
give equal maps, bit by bit.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.map_builder.cell_record import (
    TILE,
    CellRecord,
    Decision,
    Tiles,
    cells_in,
    set_of,
)
from cairn.components.map_builder.occupancy import Occupancy
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN
from cairn.visual_map.shared_record import MOST_STAMP_NS

_OUTLASTS_NS: Final = 60 * SECOND
"""A robot whose scans have confirmed a cell so much later than another robot has decided otherwise
[ns] decides again. A decision that is newer is adopted, and judged by further scans: otherwise two
robots that see a border cell differently would contradict each other with every scan."""


class CellSharing:
    """This robot's part in the shared record of the cells of one map.

    `original` are the cells of the map from which all robots started, `cells` those that the record
    gives: FREE, OCCUPIED or UNKNOWN.
    """

    def __init__(
        self, robot: str, original: NDArray[np.int8], decisions: Iterable[Decision] = ()
    ) -> None:
        self.robot = robot
        self.record = CellRecord(decisions)
        self.tiles = Tiles((original.shape[0], original.shape[1]))
        self._original = original.copy()
        self.cells = original.copy()
        self._changed: dict[int, int] = {}
        self._to_send: dict[tuple[int, int], Decision] = {}
        self._newest_ns = self.record.newest_of(robot)
        for tile in self.record.tiles:
            self._apply(tile)

    @property
    def newest_ns(self) -> int:
        """Return the time of this robot's newest decision [ns]."""
        return max(self._newest_ns, self.record.newest_of(self.robot))

    @property
    def changed_cells(self) -> int:
        """Return the number of cells that differ from the map from which all robots started."""
        return sum(self._changed.values())

    def is_changed(self, window: tuple[slice, slice]) -> NDArray[np.bool_]:
        """Return which cells of a window differ from the map from which all robots started."""
        changed: NDArray[np.bool_] = self.cells[window] != self._original[window]
        return changed

    def contribute(
        self, cells: NDArray[np.int8], box: tuple[int, int, int, int], now_ns: int
    ) -> bool:
        """Decide what differs in this robot's map from what the record gives.

        Args:
            cells: The robot's map.
            box: The first row and column in which it may differ, and those after the last.
            now_ns: The time of the robot's newest evidence about these cells.

        Returns:
            Whether anything differs. The record then gives the robot's map in this box.
        """
        top, left, bottom, right = box
        rows, columns = np.nonzero(
            cells[top:bottom, left:right] != self.cells[top:bottom, left:right]
        )
        if not rows.size:
            return False
        changed = self.tiles.at(rows + top, columns + left)
        known = [one.stamp_ns for tile in changed for one in self.record.about(tile)]
        stamp_ns = min(
            max([now_ns, self.newest_ns + 1, *(one + 1 for one in known)]), MOST_STAMP_NS
        )
        for tile in changed:
            window = self.tiles.window(tile)
            mine = cells[window]
            differs = mine != self.cells[window]
            one = Decision(
                self.robot,
                tile,
                stamp_ns,
                free=set_of(differs & (mine == FREE)),
                occupied=set_of(differs & (mine == OCCUPIED)),
                unknown=set_of(differs & (mine == UNKNOWN)),
            )
            self.record.merge([one])
            self._to_send[one.subject] = one
            self._apply(tile)
        self._newest_ns = stamp_ns
        return True

    def merge(
        self, decisions: Iterable[Decision], occupancy: Occupancy
    ) -> list[tuple[slice, slice]]:
        """Take in decisions of robots; return the windows of the map that they change.

        They must have passed `check_decision`, and `occupancy` must have what the record gives.
        What this robot has seen since, it decides again.
        """
        windows, kept = [], []
        adopted = [np.zeros(0, np.int64)]
        for tile in sorted(self.record.merge(decisions)):
            self._apply(tile)
            window = self.tiles.window(tile)
            differs = self.cells[window] != occupancy.cells[window]
            if not differs.any():
                continue
            confirmed_ns = occupancy.confirmed_ns(window)
            stays = differs & (confirmed_ns > self._decided_ns(tile) + _OUTLASTS_NS)
            if stays.any():
                kept.append((window, int(confirmed_ns[stays].min())))
            rows, columns = np.nonzero(differs & ~stays)
            if rows.size:
                rows, columns = rows + window[0].start, columns + window[1].start
                adopted.append(rows * self.cells.shape[1] + columns)
                windows.append(window)
        chosen = np.concatenate(adopted)
        if chosen.size:
            occupancy.adopt(chosen, self.cells.flat[chosen])
        for (rows_of, columns_of), confirmed in kept:
            box = (rows_of.start, columns_of.start, rows_of.stop, columns_of.stop)
            self.contribute(occupancy.cells, box, confirmed)
        return windows

    def take_decisions(self, most: int) -> list[Decision]:
        """Return this robot's own decisions that were not sent yet, at most `most`."""
        return [self._to_send.pop(key) for key in list(self._to_send)[:most]]

    def _apply(self, tile: int) -> None:
        """Compute the cells of a tile from the record."""
        window = self.tiles.window(tile)
        values = self._original[window].copy()
        rows, columns = values.shape
        for one in self.record.about(tile):
            for members, value in one.values():
                if members:
                    values[cells_in(members)[:rows, :columns]] = value
        self.cells[window] = values
        self._changed[tile] = int(np.count_nonzero(self.is_changed(window)))

    def _decided_ns(self, tile: int) -> NDArray[np.int64]:
        """Return when each cell of a tile was decided [ns]; 0: never."""
        decided = np.zeros((TILE, TILE), np.int64)
        for one in self.record.about(tile):
            decided[cells_in(one.cells)] = one.stamp_ns
        rows, columns = self.tiles.window(tile)
        return decided[: rows.stop - rows.start, : columns.stop - columns.start]
