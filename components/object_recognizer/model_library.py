"""The object models of the map file and their recognizer, reloaded when objects are taught."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from cairn.vision.object_model import ObjectModel
from cairn.vision.recognition import Recognizer
from cairn.visual_map.object_models import read_models, read_revision


@dataclass(frozen=True)
class LoadedModels:
    """The object models of a `revision`, by identifier, and their recognizer."""

    revision: int
    models: Mapping[int, ObjectModel]
    recognizer: Recognizer


class ModelLibrary:
    """The object models that can be recognized at present.

    A recognizer of many objects takes many seconds to build, so another thread builds it while the
    former one is in use.
    """

    def __init__(self, path: Path) -> None:
        """Read the file; raise `MapFileError` if it cannot be read."""
        self._path = path
        self.current = _load(path)
        self._next: Future[LoadedModels] | None = None

    def refresh(self) -> bool:
        """Start to reload the file if it has changed; return whether new models are in use now.

        Raises `MapFileError` if the file cannot be read; the current models stay in use.
        """
        if self._next is not None:
            if not self._next.done():
                return False
            loaded, self._next = self._next, None
            self.current = loaded.result()
            return True
        if read_revision(self._path) != self.current.revision:
            self._next = Future()
            threading.Thread(target=_load_into, args=(self._next, self._path), daemon=True).start()
        return False


def _load(path: Path) -> LoadedModels:
    read = read_models(path, pictures=False)
    models = {model.object_id: model for model in read.models}
    return LoadedModels(read.revision, models, Recognizer(read.models))


def _load_into(future: Future[LoadedModels], path: Path) -> None:
    try:
        future.set_result(_load(path))
    except Exception as error:  # `Future.result` raises it in the caller
        future.set_exception(error)
