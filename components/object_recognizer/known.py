"""The taught objects of a map's file, and what recognises them; kept up to date."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from vision.recognition import Recognizer
from vision.taught import TaughtObject
from vision.taught_store import read_taught, taught_number


class KnownObjects:
    """What can be recognised at present."""

    def __init__(self, path: Path) -> None:
        """Read the file; raises `MapFileError` if it cannot be."""
        self._path = path
        self._read()

    @property
    def objects(self) -> Mapping[int, TaughtObject]:
        """All taught objects, by number."""
        return self._objects

    @property
    def recognizer(self) -> Recognizer:
        """What recognises them."""
        return self._recognizer

    def refresh(self) -> bool:
        """Read the file again if what was taught has changed; whether it has.

        Raises `MapFileError` if it cannot be read, and is then as before.
        """
        if taught_number(self._path) == self._number:
            return False
        self._read()
        return True

    def _read(self) -> None:
        taught = read_taught(self._path)
        self._recognizer = Recognizer(taught.objects)
        self._objects = {known.object_id: known for known in taught.objects}
        self._number = taught.number
