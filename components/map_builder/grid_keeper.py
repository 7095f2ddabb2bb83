"""Keeps the grid map and its files: what it began with, the copy that is changed, when to save."""

from __future__ import annotations

import hashlib
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from cairn import CairnError
from cairn.components.map_builder.occupancy import Occupancy
from cairn.components.map_builder.window import Window
from cairn.components.map_builder.working_copy import LOG, gone_on_with
from cairn.files import replace_file
from cairn.planar.grid import OccupancyCells
from cairn.planar.map_file import read_map, write_map
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays


class _Origin(BaseModel):
    """Of which map a working copy is, and up to when it was changed."""

    model_config = ConfigDict(extra="forbid")

    source: str
    stamp_ns: int


class GridKeeper:
    """A grid map on disk and in memory.

    With a `working_copy` the map itself is only read: the copy is written by `save`, and is gone
    on with if it is one of the same map and not of a later time, as after the death of the process
    that wrote it. Without one the changes are in memory alone.
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
        left = _left(working_copy, self._source, now_ns) if working_copy is not None else None
        self._occupancy = Occupancy(left or original, settle_s, undo_s)
        self._changed = False

    @property
    def occupancy(self) -> Occupancy:
        """The map."""
        return self._occupancy

    def integrate(self, stamp_s: float, pose: Pose, rays: Rays) -> Window | None:
        """Take a scan from a known pose; gives what has changed."""
        window = self._occupancy.integrate(stamp_s, pose, rays)
        self._changed |= window is not None
        return window

    def take_back(self, stamp_s: float) -> Window | None:
        """Undo what was changed since `stamp_s` [s]; gives what has changed by that."""
        window = self._occupancy.take_back(stamp_s)
        self._changed |= window is not None
        return window

    def save(self, now_ns: int) -> None:
        """Write the working copy if anything has changed since it was written.

        Raises `CairnError` if it cannot be written; what has changed is written by the next call.
        """
        if self._copy is None or not self._changed:
            return
        write_map(self._copy, self._occupancy.grid)
        origin = _Origin(source=self._source, stamp_ns=now_ns)
        sidecar = _sidecar(self._copy)
        try:
            replace_file(sidecar, origin.model_dump_json().encode())
        except OSError as error:
            raise CairnError(
                f"{sidecar} cannot be written: {error.strerror}; make room there, or remove what "
                "is in its place"
            ) from error
        self._changed = False


def _sidecar(copy: Path) -> Path:
    return copy.with_suffix(".origin.json")


def _digest(map_: OccupancyCells) -> str:
    """What identifies the content of a grid map, whichever files it stands in."""
    content = hashlib.sha256(repr((map_.values.shape, map_.frame)).encode())
    content.update(map_.values.tobytes())
    return content.hexdigest()


def _left(copy: Path, source: str, now_ns: int) -> OccupancyCells | None:
    """The map of a working copy that can be gone on with; the log is told why it cannot."""
    sidecar = _sidecar(copy)
    try:
        origin = _Origin.model_validate_json(sidecar.read_bytes())
        cells = read_map(copy)
    except FileNotFoundError:
        return None
    except (OSError, CairnError) as error:
        LOG.warning("making the working copy %s anew: %s", copy, error)
        return None
    except ValidationError:
        LOG.warning("making the working copy %s anew: %s tells of no map", copy, sidecar)
        return None
    ahead = origin.stamp_ns > now_ns
    return cells if gone_on_with(copy, same=origin.source == source, ahead=ahead) else None
