"""Keeps the grid map: its original, its working copy on disk, and updates to publish."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cairn import SECOND, CairnError
from cairn.components.map_builder.cell_record import TILE, Decision, Tiles, check_decision
from cairn.components.map_builder.grid_sharing import CellSharing
from cairn.components.map_builder.occupancy import Occupancy, known_cells
from cairn.components.map_builder.undo import GridWindow
from cairn.limits.files import STATE_BYTES, read_bounded
from cairn.planar.grid import FREE, OCCUPIED, OccupancyCells
from cairn.planar.map_file import read_map, write_map
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays
from cairn.system.files import explain_os_error, replace_file
from cairn.system.working_copy import is_reusable, set_aside

_LOG = logging.getLogger("cairn.map_builder")

Box = tuple[int, int, int, int]
"""The first row and column of a part of a map, and those after the last."""


_STORED_BYTES: Final = 30
"""Room for the stored record for each cell of the map [bytes]. A decision takes 120 bytes or more,
and is about some ten cells or more on average; forged ones may be about fewer."""


class _StoredDecision(BaseModel):
    """A decision of a robot; sets of cells are hexadecimal numbers."""

    model_config = ConfigDict(extra="forbid")

    robot: str
    tile: int
    stamp_ns: int
    free: str | None = Field(None, pattern="^[0-9a-f]{1,64}$")
    occupied: str | None = Field(None, pattern="^[0-9a-f]{1,64}$")
    unknown: str | None = Field(None, pattern="^[0-9a-f]{1,64}$")

    @classmethod
    def of(cls, one: Decision) -> _StoredDecision:
        free, occupied, unknown = (
            f"{cells:x}" if cells else None for cells in (one.free, one.occupied, one.unknown)
        )
        return cls(
            robot=one.robot,
            tile=one.tile,
            stamp_ns=one.stamp_ns,
            free=free,
            occupied=occupied,
            unknown=unknown,
        )

    def decision(self) -> Decision:
        free, occupied, unknown = (
            int(text or "0", 16) for text in (self.free, self.occupied, self.unknown)
        )
        return Decision(self.robot, self.tile, self.stamp_ns, free, occupied, unknown)


class _StoredRecord(BaseModel):
    """The record that robots share, in format 1: tiles of `tile` x `tile` cells."""

    model_config = ConfigDict(extra="forbid")

    format: Literal[1] = 1
    tile: Literal[16] = TILE
    decisions: list[_StoredDecision]


class _CopyOrigin(BaseModel):
    """The map of which a working copy is, the time of its last change, and what robots share."""

    model_config = ConfigDict(extra="forbid")

    source: str
    stamp_ns: int
    shared: _StoredRecord | None = None


class GridKeeper:
    """A grid map on disk and in memory.

    With a `working_copy` the map itself is only read: `save` writes the copy. It is used again if
    it is one of the same map and not of a later time than `now_ns` (None: of any time, see
    `LandmarkKeeper`), as after the process that wrote it was killed. Without a copy, changes are in
    memory only.

    With `robot`, the cells are shared under this name with robots that have the same map: `merge`
    takes what they have decided, `contribute` decides what this robot has found out itself.
    """

    def __init__(
        self,
        map_file: Path,
        working_copy: Path | None,
        now_ns: int | None,
        settle_s: float,
        undo_s: float,
        robot: str | None = None,
    ) -> None:
        self._copy = working_copy
        original = read_map(map_file)
        self._source = grid_digest(original)
        previous = (
            _read_copy(working_copy, self._source, original, now_ns)
            if working_copy is not None
            else None
        )
        cells, stored, stamp_ns = previous or (original, None, 0)
        self.occupancy = Occupancy(cells, settle_s, undo_s)
        self._changed = False
        self._stored = stored
        self._undecided: Box | None = None
        self._newest_ns = 0
        self.sharing: CellSharing | None = None
        if robot is not None:
            decisions = [] if stored is None else [one.decision() for one in stored.decisions]
            self.sharing = CellSharing(robot, known_cells(original), decisions)
            # What the robot has changed while it did not share.
            rows, columns = self.occupancy.cells.shape
            self._undecided = (0, 0, rows, columns)
            self._newest_ns = stamp_ns
            self.contribute()

    def integrate(self, stamp_s: float, pose: Pose, rays: Rays) -> GridWindow | None:
        """Integrate a scan from a known pose; return the window that this changes."""
        window = self.occupancy.integrate(stamp_s, pose, rays)
        self._note(window, round(stamp_s * SECOND))
        return window

    def undo(self, stamp_s: float, now_ns: int) -> GridWindow | None:
        """Undo at `now_ns` the changes since `stamp_s` [s]; return the window that this changes.

        Cells that other robots have decided about since then stay as they are.
        """
        window = self.occupancy.undo(stamp_s)
        self._note(window, now_ns)
        return window

    def contribute(self) -> None:
        """Decide for all robots what this one has changed since the last call."""
        box, self._undecided = self._undecided, None
        if self.sharing is not None and box is not None:
            self._changed |= self.sharing.contribute(self.occupancy.cells, box, self._newest_ns)

    def merge(self, decisions: Iterable[Decision]) -> list[GridWindow]:
        """Take in decisions of other robots; return the windows that they change.

        They must have passed `check_decision`.
        """
        assert self.sharing is not None
        self.contribute()
        before = self.sharing.record.summaries()
        windows = self.sharing.merge(decisions, self.occupancy)
        self._changed |= before != self.sharing.record.summaries()
        cells = self.occupancy.cells
        return [
            GridWindow(rows.start, columns.start, cells[rows, columns].copy())
            for rows, columns in windows
        ]

    def free_own_place(self, x: float, y: float, radius: float, now_ns: int) -> GridWindow | None:
        """Free the obstacles that other robots have added where this one stands, at `now_ns`.

        They have seen this robot, without knowing that it is one. `x`, `y`, `radius` [m] are where
        it stands. Returns the window that this changes.
        """
        assert self.sharing is not None
        frame = self.occupancy.frame
        rows, columns = self.occupancy.cells.shape
        column, row = frame.cells(x, y)
        reach = radius / frame.resolution + 0.5  # as the planner, which finds a start blocked
        top, left = max(0, int(row - reach)), max(0, int(column - reach))
        bottom, right = min(rows, int(row + reach) + 1), min(columns, int(column + reach) + 1)
        if top >= bottom or left >= right:
            return None
        window = slice(top, bottom), slice(left, right)
        down, across = np.ogrid[top:bottom, left:right]
        below = (down + 0.5 - row) ** 2 + (across + 0.5 - column) ** 2 <= reach**2
        added = (self.occupancy.cells[window] == OCCUPIED) & self.sharing.is_changed(window)
        found, beside = np.nonzero(below & added)
        if not found.size:
            return None
        flat = (found + top) * columns + beside + left
        self.occupancy.adopt(flat, np.full(flat.shape, FREE, np.int8))
        freed = GridWindow(top, left, self.occupancy.cells[window].copy())
        self._note(freed, now_ns)
        return freed

    def save(self, now_ns: int) -> None:
        """Write the working copy if anything has changed since the last time.

        Raises `CairnError` if it cannot be written; the next call tries again.
        """
        if self._copy is None or not self._changed:
            return
        write_map(self._copy, self.occupancy.grid)
        if self.sharing is not None:
            decisions = [_StoredDecision.of(one) for one in self.sharing.record]
            self._stored = _StoredRecord(decisions=decisions)
        origin = _CopyOrigin(source=self._source, stamp_ns=now_ns, shared=self._stored)
        sidecar = _sidecar(self._copy)
        try:
            replace_file(sidecar, origin.model_dump_json(exclude_none=True).encode())
        except OSError as error:
            raise CairnError(f"{sidecar} cannot be written: {explain_os_error(error)}") from error
        self._changed = False

    def _note(self, window: GridWindow | None, now_ns: int) -> None:
        """Note that the robot has changed a window of the map, at `now_ns`."""
        if window is None:
            return
        self._changed = True
        self._newest_ns = max(self._newest_ns, now_ns)
        self._undecided = joined_box(self._undecided, window)


def joined_box(box: Box | None, window: GridWindow) -> Box:
    """Return the smallest box of first and past-the-end rows and columns around both."""
    top, left, bottom, right = window.box
    if box is None:
        return window.box
    return min(top, box[0]), min(left, box[1]), max(bottom, box[2]), max(right, box[3])


class PendingUpdates:
    """Collects changed windows into one update to publish."""

    def __init__(self) -> None:
        self._box: Box | None = None
        self.full_map_is_outdated = False

    def add(self, window: GridWindow | None) -> None:
        """Add a window that has changed."""
        if window is None:
            return
        self._box = joined_box(self._box, window)

    def take(self, cells: NDArray[np.int8]) -> GridWindow | None:
        """Return all changes since the last call, with present values; None without changes."""
        if self._box is None:
            return None
        top, left, bottom, right = self._box
        self._box = None
        self.full_map_is_outdated = True
        return GridWindow(top, left, cells[top:bottom, left:right].copy())

    def full_map_published(self) -> None:
        """Note that the full map was published."""
        self._box = None
        self.full_map_is_outdated = False


def _sidecar(copy: Path) -> Path:
    return copy.with_suffix(".origin.json")


def grid_digest(map_: OccupancyCells) -> str:
    """Return a digest of the content of a grid map, independent of its files."""
    content = hashlib.sha256(repr((map_.values.shape, map_.frame)).encode())
    content.update(map_.values.tobytes())
    return content.hexdigest()


def _read_copy(
    copy: Path, source: str, original: OccupancyCells, now_ns: int | None
) -> tuple[OccupancyCells, _StoredRecord | None, int] | None:
    """Return the map of a reusable working copy, what is shared, and its time.

    Logs why it is not reusable.
    """
    sidecar = _sidecar(copy)
    tiles = Tiles((original.values.shape[0], original.values.shape[1]))
    try:
        limit = STATE_BYTES + _STORED_BYTES * original.values.size
        origin = _CopyOrigin.model_validate_json(read_bounded(sidecar, limit))
        for one in [] if origin.shared is None else origin.shared.decisions:
            check_decision(one.decision(), tiles)
        cells = read_map(copy)
        if cells.values.shape != original.values.shape:
            raise CairnError(f"{copy}: its size is not that of the map")
    except FileNotFoundError:
        return None
    except (OSError, CairnError) as error:
        set_aside(copy, _LOG, error, copy.with_suffix(".pgm"), sidecar)
        return None
    except ValueError:
        set_aside(copy, _LOG, f"{sidecar} is not valid", copy.with_suffix(".pgm"), sidecar)
        return None
    ahead = now_ns is not None and origin.stamp_ns > now_ns
    if not is_reusable(copy, _LOG, same=origin.source == source, ahead=ahead):
        return None
    return cells, origin.shared, origin.stamp_ns
