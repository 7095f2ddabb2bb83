"""Keeps the grid map and its files: what it began with, the copy that is changed, when to save."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from cairn.errors import CairnError
from components.map_builder.occupancy import Occupancy, Window
from planar.map_file import read_map, write_map
from planar.poses import Pose
from planar.sweep import Rays


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
        self, map_file: Path, working_copy: Path | None, now_ns: int, settle_s: float
    ) -> None:
        self._copy = working_copy
        self._source = _digest(map_file)
        here = _gone_on_with(map_file, working_copy, self._source, now_ns)
        self._occupancy = Occupancy(read_map(here), settle_s)
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
        """Write the working copy if anything has changed since it was written."""
        if self._copy is None or not self._changed:
            return
        write_map(self._copy, self._occupancy.grid)
        origin = _Origin(source=self._source, stamp_ns=now_ns)
        _sidecar(self._copy).write_text(origin.model_dump_json(), encoding="utf-8")
        self._changed = False


def _sidecar(copy: Path) -> Path:
    return copy.with_suffix(".origin.json")


def _digest(map_file: Path) -> str:
    try:
        return hashlib.sha256(map_file.read_bytes()).hexdigest()
    except OSError as error:
        raise CairnError(
            f"{map_file}: cannot be read: {error.strerror}; give a map_server YAML file"
        ) from error


def _gone_on_with(map_file: Path, copy: Path | None, source: str, now_ns: int) -> Path:
    if copy is None:
        return map_file
    try:
        origin = _Origin.model_validate_json(_sidecar(copy).read_text(encoding="utf-8"))
    except (OSError, ValidationError):
        return map_file
    if origin.source != source or origin.stamp_ns > now_ns or not copy.exists():
        return map_file
    logging.getLogger("cairn.map_builder").info("going on with the working copy %s", copy)
    return copy
