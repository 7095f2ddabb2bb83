"""Keeps the grid map: its original, its working copy on disk, and updates to publish."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from cairn import CairnError
from cairn.bounded_files import STATE_BYTES, read_bounded
from cairn.components.map_builder.occupancy import Occupancy
from cairn.components.map_builder.undo import GridWindow
from cairn.files import explain_os_error, replace_file
from cairn.planar.grid import OccupancyCells
from cairn.planar.map_file import read_map, write_map
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays
from cairn.working_copy import is_reusable

_LOG = logging.getLogger("cairn.map_builder")


class _CopyOrigin(BaseModel):
    """The map of which a working copy is, and the time of its last change."""

    model_config = ConfigDict(extra="forbid")

    source: str
    stamp_ns: int


class GridKeeper:
    """A grid map on disk and in memory.

    With a `working_copy` the map itself is only read: `save` writes the copy. It is used again if
    it is one of the same map and not of a later time, as after the process that wrote it was
    killed. Without a copy, changes are in memory only.
    """

    def __init__(
        self,
        map_file: Path,
        working_copy: Path | None,
        now_ns: int,
        settle_s: float,
        undo_s: float,
    ) -> None:
        self._copy = working_copy
        original = read_map(map_file)
        self._source = _digest(original)
        previous = (
            _read_copy(working_copy, self._source, now_ns) if working_copy is not None else None
        )
        self._occupancy = Occupancy(previous or original, settle_s, undo_s)
        self._changed = False

    @property
    def occupancy(self) -> Occupancy:
        """Return the map."""
        return self._occupancy

    def integrate(self, stamp_s: float, pose: Pose, rays: Rays) -> GridWindow | None:
        """Integrate a scan from a known pose; return the window that this changes."""
        window = self._occupancy.integrate(stamp_s, pose, rays)
        self._changed |= window is not None
        return window

    def undo(self, stamp_s: float) -> GridWindow | None:
        """Undo the changes since `stamp_s` [s]; return the window that this changes."""
        window = self._occupancy.undo(stamp_s)
        self._changed |= window is not None
        return window

    def save(self, now_ns: int) -> None:
        """Write the working copy if anything has changed since the last time.

        Raises `CairnError` if it cannot be written; the next call tries again.
        """
        if self._copy is None or not self._changed:
            return
        write_map(self._copy, self._occupancy.grid)
        origin = _CopyOrigin(source=self._source, stamp_ns=now_ns)
        sidecar = _sidecar(self._copy)
        try:
            replace_file(sidecar, origin.model_dump_json().encode())
        except OSError as error:
            raise CairnError(f"{sidecar} cannot be written: {explain_os_error(error)}") from error
        self._changed = False


class PendingUpdates:
    """Collects changed windows into one update to publish."""

    def __init__(self) -> None:
        self._box: tuple[int, int, int, int] | None = None
        self.full_map_is_outdated = False

    def add(self, window: GridWindow | None) -> None:
        """Add a window that has changed."""
        if window is None:
            return
        box = window.box
        if self._box is not None:
            top, left, bottom, right = self._box
            box = (min(top, box[0]), min(left, box[1]), max(bottom, box[2]), max(right, box[3]))
        self._box = box

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


def _digest(map_: OccupancyCells) -> str:
    """Return a digest of the content of a grid map, independent of its files."""
    content = hashlib.sha256(repr((map_.values.shape, map_.frame)).encode())
    content.update(map_.values.tobytes())
    return content.hexdigest()


def _read_copy(copy: Path, source: str, now_ns: int) -> OccupancyCells | None:
    """Return the map of a reusable working copy; log why it is not reusable."""
    sidecar = _sidecar(copy)
    try:
        origin = _CopyOrigin.model_validate_json(read_bounded(sidecar, STATE_BYTES))
        cells = read_map(copy)
    except FileNotFoundError:
        return None
    except (OSError, CairnError) as error:
        _LOG.warning("replacing the working copy %s: %s", copy, error)
        return None
    except ValidationError:
        _LOG.warning("replacing the working copy %s: %s is not valid", copy, sidecar)
        return None
    ahead = origin.stamp_ns > now_ns
    return cells if is_reusable(copy, _LOG, same=origin.source == source, ahead=ahead) else None
