"""Proposals: things that may become landmarks, and rejected ones, in a visual map of their own."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from cairn import CairnError, from_ns
from cairn.components.object_recognizer.hypotheses import MOST_PROPOSALS, Hypothesis
from cairn.schemas.cairn_msgs import ObjectProposal, VisualObject
from cairn.vision.images import Gray
from cairn.vision.object_model import ObjectModel
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.landmarks import INITIAL_RELIABILITY, LandmarkRecord, MapPosition
from cairn.visual_map.new_map import write_map
from cairn.visual_map.object_models import add_views, check_name, read_models

_SOURCE = "things that were never taught, found by the object finder"
_THUMBNAIL_PX = 160


@dataclass(frozen=True)
class Proposal:
    """A thing with its model, position in the map, and evidence.

    `model.object_id` is its number. `seen` is how often it was recognized, since `first_ns` [ns].
    """

    model: ObjectModel
    position: MapPosition
    seen: int
    first_ns: int
    is_rejected: bool = False

    def describe(self) -> dict[str, Any]:
        """Return it for a reply in JSON."""
        width, height = self.model.size or (0.0, 0.0)
        return {
            "number": self.model.object_id,
            "name": self.model.name,
            "x": self.position.x,
            "y": self.position.y,
            "sd": (self.position.xx + self.position.yy) ** 0.5,
            "width": width,
            "height": height,
            "seen": self.seen,
            "first_s": self.first_ns / 1e9,
        }

    def landmark(self, accepted: ObjectModel) -> VisualObject:
        """Return the landmark that it becomes with its model as an object."""
        p = self.position
        return VisualObject(
            object_id=accepted.object_id,
            name=accepted.name,
            x=p.x,
            y=p.y,
            covariance=np.array([p.xx, p.xy, p.xy, p.yy]),
            reliability=INITIAL_RELIABILITY,
        )

    def message(self) -> ObjectProposal:
        """Return it as a message."""
        width, height = self.model.size or (1.0, 1.0)
        p = self.position
        return ObjectProposal(
            number=self.model.object_id,
            name=self.model.name,
            x=p.x,
            y=p.y,
            covariance=np.array([p.xx, p.xy, p.xy, p.yy]),
            width=width,
            height=height,
            seen=self.seen,
            first=from_ns(self.first_ns),
            picture=_thumbnail(self.model.views[0].picture),
        )


class Proposals:
    """All proposals and rejected things by number, and their file."""

    def __init__(self, path: Path) -> None:
        """Read the file if it exists; raise `MapFileError` if it is not readable."""
        self.path = path
        self._all: dict[int, Proposal] = {}
        self.is_saved = True
        """Whether the file has all of it."""
        if path.exists():
            self._read()
        self._last = max(self._all, default=0)

    @property
    def waiting(self) -> list[Proposal]:
        """What may be accepted or rejected, by number."""
        return [one for one in self._all.values() if not one.is_rejected]

    @property
    def models(self) -> list[ObjectModel]:
        """The models of all proposals and rejected things."""
        return [one.model for one in self._all.values()]

    @property
    def is_full(self) -> bool:
        """Whether nothing more can be proposed."""
        return len(self._all) >= MOST_PROPOSALS

    def add(self, hypothesis: Hypothesis) -> Proposal:
        """Propose a hypothesis."""
        self._last = number = self._last + 1
        (x, y), spread = hypothesis.place()
        model = replace(hypothesis.model, object_id=number, name=f"found {number}")
        position = MapPosition(
            float(x), float(y), float(spread[0, 0]), float(spread[0, 1]), float(spread[1, 1])
        )
        one = Proposal(model, position, hypothesis.seen, hypothesis.first_ns)
        self._all[number] = one
        self.is_saved = False
        return one

    def waiting_one(self, number: int) -> Proposal:
        """Return a proposal; raise `CairnError` if there is none of that number."""
        one = self._all.get(number)
        if one is None or one.is_rejected:
            numbers = ", ".join(str(each.model.object_id) for each in self.waiting) or "none"
            raise CairnError(f"there is no proposal {number}; available: {numbers}")
        return one

    def reject(self, number: int) -> None:
        """Keep a thing as rejected, so that it is not proposed again."""
        self._all[number] = replace(self.waiting_one(number), is_rejected=True)
        self.is_saved = False

    def remove(self, number: int) -> None:
        """Forget a proposal that was accepted."""
        del self._all[number]
        self.is_saved = False

    def save(self) -> None:
        """Write the file; raise `CairnError` or `OSError` if that fails, the old one stays."""
        landmarks = [_record(one) for one in self._all.values()]
        write_map(self.path, _SOURCE, landmarks, 0, self.models)
        self.is_saved = True

    def _read(self) -> None:
        models: Mapping[int, ObjectModel] = {
            model.object_id: model for model in read_models(self.path).models
        }
        with open_landmarks(self.path, read_only=True) as store:
            records = store.landmarks()
            firsts = {one.object_id: store.changes_of(one.object_id) for one in records}
        if len(records) > MOST_PROPOSALS:
            raise CairnError(
                f"{self.path}: has {len(records):,} landmarks, more than the {MOST_PROPOSALS} "
                "proposals that are kept, so it is not a file of proposals; give another "
                "name (proposals_file)"
            )
        for record in records:
            model = models.get(record.object_id)
            if model is None or model.size is None or record.position is None:
                raise CairnError(
                    f"{self.path}: {record.name} has no model, no size or no position, so this is "
                    "no file of proposals; give another name (proposals_file), or delete it"
                )
            changes = firsts[record.object_id]
            self._all[record.object_id] = Proposal(
                model,
                record.position,
                record.evidence_count,
                changes[0].stamp_ns if changes else 0,
                record.reliability < INITIAL_RELIABILITY / 2,
            )


def accept(one: Proposal, name: str | None, map_file: Path) -> ObjectModel:
    """Add a proposed thing to the objects that the recognizer knows; return its model there.

    Without a name it keeps that of the proposal. Raises `CairnError` if the name is not valid or
    taken, or if the map cannot be written.
    """
    taken = {model.name for model in read_models(map_file, pictures=False).models}
    if name is None:
        name = _free_name(one.model.name, taken)
    check_name(name)
    if name in taken:
        raise CairnError(f"{map_file} has an object {name!r} already; give another name")
    object_id = add_views(map_file, name, one.model.views, one.model.size)
    return replace(one.model, object_id=object_id, name=name)


def _free_name(wanted: str, taken: Collection[str]) -> str:
    name, number = wanted, 2
    while name in taken:
        name, number = f"{wanted} ({number})", number + 1
    return name


def _record(one: Proposal) -> LandmarkRecord:
    return LandmarkRecord(
        one.model.object_id,
        one.model.name,
        one.position,
        reliability=0.0 if one.is_rejected else INITIAL_RELIABILITY,
        evidence_count=one.seen,
    )


def _thumbnail(picture: Gray) -> np.ndarray[Any, np.dtype[np.uint8]]:
    scale = min(1.0, _THUMBNAIL_PX / max(picture.shape))
    width, height = (max(1, round(scale * side)) for side in picture.shape[::-1])
    small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.imencode(".jpg", small)[1], np.uint8).ravel()
