"""Writes new visual maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cairn.system.files import replacing
from cairn.vision.object_model import ObjectModel
from cairn.visual_map.landmark_store import create_landmarks
from cairn.visual_map.landmarks import ChangeKind, LandmarkChange, LandmarkRecord
from cairn.visual_map.object_models import add_views


def write_map(
    path: Path,
    source: str,
    landmarks: Sequence[LandmarkRecord],
    stamp_ns: int = 0,
    models: Sequence[ObjectModel] = (),
    created_s: float | None = None,
) -> None:
    """Write a new map file with these landmarks, each with a change IMPORTED.

    `created_s` is the time of creation in the file [s since 1970], None: the system's.
    The models of these landmarks are written as well, so robots recognize them at once.
    """
    with replacing(path) as part:
        with create_landmarks(part, source, created_s) as store:
            changes = [
                (
                    version,
                    stamp_ns,
                    LandmarkChange(
                        o.object_id, ChangeKind.IMPORTED, None, o.position, o.reliability, source
                    ),
                )
                for version, o in enumerate(landmarks, start=1)
            ]
            store.commit([replace(o) for o in landmarks], (), changes)
        known = {o.object_id for o in landmarks}
        for one in models:
            if one.object_id in known:
                add_views(part, one.name, one.views, one.size)
