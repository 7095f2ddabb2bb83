"""The invariant that no committed change of the visual map is lost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import Field

from cairn.runtime.parameters import Config
from cairn.schemas.cairn_msgs import VisualMapChange
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.sqlite_file import MapFileError
from cairn_lab.campaign import DeploymentEnded, Injection, Invariant

_DISK_FULL = "disk_full"
_UNSAVED_S = 15.0  # longer than the map builder takes to try again


class MapChangesConfig(Config):
    """Parameters of `map_changes_kept`."""

    file: str = Field(
        "visual_map.cairn",
        min_length=1,
        description="The robot's visual map, relative to the report folder of `cairn up` on the "
        "machine of the map builder.",
    )


class MapChangesKept(Invariant):
    """Each published change of the visual map is in its file when the deployment has ended.

    Changes that are published while the disk is full, or until the map builder has tried again, are
    left out: they are kept in memory.
    """

    config_type = MapChangesConfig
    config: MapChangesConfig

    topics: Mapping[str, type[Any]] = {"visual_map_changes": VisualMapChange}

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.published: dict[tuple[int, int], float] = {}
        """When a change was published [s], by its version and object."""
        self._full_until_s = float("-inf")

    def on_message(self, at_s: float, topic: str, message: Any) -> Iterable[str]:  # noqa: ARG002
        """Note a change that is committed."""
        if at_s > self._full_until_s:
            self.published.setdefault((message.version, message.object_id), at_s)
        return ()

    def on_fault(self, at_s: float, kind: str, fault: Injection) -> Iterable[str]:  # noqa: ARG002
        """Expect nothing of a full disk."""
        if kind == _DISK_FULL:
            self._full_until_s = float("inf")
        return ()

    def on_undo(self, at_s: float, kind: str, fault: Injection) -> Iterable[str]:  # noqa: ARG002
        """Expect changes on the disk again."""
        if kind == _DISK_FULL:
            self._full_until_s = at_s + _UNSAVED_S
        return ()

    def on_end(self, end: DeploymentEnded) -> Iterable[str]:
        """Compare what was published with the file."""
        if not self.published:
            return
        paths = [report / self.config.file for report in end.reports]
        path = next((one for one in paths if one.exists()), paths[0])
        try:
            with open_landmarks(path, read_only=True) as store:
                kept = {(version, number) for version, _, number, *_ in store.history()}
        except MapFileError as error:
            yield f"the visual map cannot be read: {error}"
            return
        for version, number in sorted(self.published.keys() - kept):
            at_s = self.published.pop((version, number))
            yield (
                f"change {version} of the visual map, of object {number}, was published at "
                f"{at_s:.1f} s and is not in {path.name}"
            )
