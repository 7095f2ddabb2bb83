"""Keeps the zones on the map: their file, and the requests that change them."""

from __future__ import annotations

from collections.abc import Mapping
from logging import Logger
from pathlib import Path
from typing import Any, Final

from cairn import CairnError
from cairn.limits.files import read_bounded
from cairn.planar.zones import (
    ZONE_FILE_BYTES,
    DamagedZones,
    feature_of,
    file_content,
    zone_of,
    zones_in,
    zones_of,
)
from cairn.schemas.cairn_nav_msgs import Zone
from cairn.system.files import explain_os_error, replace_file
from cairn.system.working_copy import path_aside, set_aside

CHANGES: Final = ("set_zones", "add_zone", "remove_zone")
"""The requests that change zones."""


class ZoneKeeper:
    """The zones on a map, in memory and in their file.

    A change is made in two steps: `change` makes it in memory, `save` writes the file. The file is
    changed by requests only: zones that were edited in it meanwhile are never overwritten.
    """

    def __init__(self, file: Path, log: Logger) -> None:
        """Read the zones; a file that does not exist has none, one that is not JSON is set aside.

        Raises `CairnError`, also if a zone is invalid.
        """
        if not file.parent.is_dir():
            raise CairnError(f"{file.parent}: no such folder to keep the zones in (zones_file)")
        self.file = file
        self.version = 1
        self.is_saved = True
        """Whether the file has the zones that are in force."""
        self.zones: tuple[Zone, ...] = ()
        self._content = _content(file)
        try:
            if self._content is not None:
                self.zones = zones_in(self._content)
        except DamagedZones as error:
            set_aside(file, log, error)
            self._content = _content(file)
        except CairnError as error:
            raise CairnError(f"{file}: {error}") from error

    @property
    def problem(self) -> str | None:
        """What is wrong as long as there is a file that was set aside; else None."""
        kept = path_aside(self.file)
        if not kept.exists():
            return None
        return (
            f"the zones in {kept}, which was damaged, are not in force: correct it and rename it "
            f"to {self.file.name}, or remove it"
        )

    def describe(self) -> dict[str, Any]:
        """Return the zones as GeoJSON features, their version, and the file."""
        return {
            "version": self.version,
            "file": str(self.file),
            "features": [feature_of(zone) for zone in self.zones],
        }

    def change(self, verb: str, arguments: Mapping[str, Any]) -> None:
        """Make the change that a request asks for; raises `CairnError`, and nothing changes.

        `set_zones` replaces all by `features`, `add_zone` adds a `feature` or replaces the zone
        named `replace` by it, `remove_zone` removes the zone `name`.
        """
        if _content(self.file) != self._content:
            raise CairnError(
                f"{self.file}: changed by another program since it was read; restart the map "
                "builder, which reads it, and repeat the change"
            )
        names = [zone.name for zone in self.zones]
        if verb == "set_zones":
            features = arguments["features"]
            if not isinstance(features, list):
                raise CairnError(f"features = {features!r:.80}: give a list of GeoJSON features")
            changed = zones_of(features)
        elif verb == "remove_zone":
            index = _index(names, arguments["name"])
            changed = self.zones[:index] + self.zones[index + 1 :]
        else:
            zone, replaced = zone_of(arguments["feature"]), arguments.get("replace")
            index = len(names) if replaced is None else _index(names, replaced)
            others = self.zones[:index], self.zones[index + 1 :]
            changed = zones_of([feature_of(one) for one in (*others[0], zone, *others[1])])
        self.zones = changed
        self.version += 1
        self.is_saved = False

    def save(self) -> None:
        """Write the file, replaced atomically; raises `OSError`, or `CairnError`."""
        if _content(self.file) != self._content:
            raise CairnError(f"{self.file}: changed by another program")
        content = file_content(self.zones)
        replace_file(self.file, content)
        self._content = content
        self.is_saved = True


def _index(names: list[str], name: Any) -> int:
    if name not in names:
        known = ", ".join(sorted(names)) or "none"
        raise CairnError(f"{name!r:.80}: no such zone; the zones are: {known}")
    return names.index(name)


def _content(file: Path) -> bytes | None:
    """Return the content of a file, None if there is none."""
    try:
        return read_bounded(file, ZONE_FILE_BYTES)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise CairnError(f"{file}: cannot be read: {explain_os_error(error)}") from error
