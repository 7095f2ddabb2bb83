"""The taught objects of a map's file, and what recognizes them; kept up to date."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from cairn.vision.recognition import Recognizer
from cairn.vision.taught import TaughtObject
from cairn.vision.taught_store import read_taught, taught_number


@dataclass(frozen=True)
class Known:
    """What was taught as of a `number`, and what recognizes it."""

    number: int
    objects: Mapping[int, TaughtObject]
    recognizer: Recognizer


class KnownObjects:
    """What can be recognized at present.

    What many objects are recognized by takes many seconds to build, so that is done by another
    thread, while those that were known before are recognized.
    """

    def __init__(self, path: Path) -> None:
        """Read the file; raises `MapFileError` if it cannot be."""
        self._path = path
        self.now = _read(path)
        self._next: Future[Known] | None = None

    def refresh(self) -> bool:
        """Begin to read the file again if what was taught has changed; whether that is done.

        Raises `MapFileError` if it cannot be read, and is then as before.
        """
        if self._next is not None:
            if not self._next.done():
                return False
            read, self._next = self._next, None
            self.now = read.result()
            return True
        if taught_number(self._path) != self.now.number:
            self._next = Future()
            threading.Thread(target=_read_into, args=(self._next, self._path), daemon=True).start()
        return False


def _read(path: Path) -> Known:
    taught = read_taught(path, pictures=False)
    objects = {known.object_id: known for known in taught.objects}
    return Known(taught.number, objects, Recognizer(taught.objects))


def _read_into(future: Future[Known], path: Path) -> None:
    try:
        future.set_result(_read(path))
    except Exception as error:  # whoever asks for the result gets it
        future.set_exception(error)
