"""Between the map builder's objects and the messages on the bus."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from cairn.components.map_builder.objects import Change, Evidence, MapObject, State, Verdict
from cairn.components.map_builder.place import Place
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import ObjectEvidenceArray, VisualMap, VisualMapChange, VisualObject
from cairn.schemas.std_msgs import Header


def evidence_of(frame: ObjectEvidenceArray) -> list[Evidence]:
    """The evidence of one frame."""
    robot = (frame.robot_x, frame.robot_y, frame.robot_theta)
    return [
        Evidence(
            object_id=piece.object_id,
            similarity=piece.similarity,
            verdict=Verdict(piece.verdict),
            distance=piece.distance,
            implied=Place(
                piece.x,
                piece.y,
                float(piece.covariance[0]),
                float(piece.covariance[1]),
                float(piece.covariance[3]),
            ),
            robot=robot,
            healthy=frame.healthy,
            corroborated=piece.corroborated,
        )
        for piece in frame.evidence
    ]


def map_message(stamp: Time, version: int, objects: Iterable[MapObject]) -> VisualMap:
    """The whole map; an object that never had a place stands at its candidate."""
    return VisualMap(
        header=Header(stamp=stamp, frame_id="map"),
        version=version,
        objects=tuple(
            message for known in objects if (message := _object_message(known)) is not None
        ),
    )


def change_message(stamp: Time, version: int, change: Change) -> VisualMapChange:
    """One change of the map; a removed object has no new place."""
    old, new = change.old, change.new
    return VisualMapChange(
        header=Header(stamp=stamp, frame_id="map"),
        version=version,
        object_id=change.object_id,
        kind=int(change.kind),
        old_x=old.x if old else math.nan,
        old_y=old.y if old else math.nan,
        new_x=new.x if new else math.nan,
        new_y=new.y if new else math.nan,
        reliability=change.reliability,
        reason=change.reason,
    )


def _object_message(known: MapObject) -> VisualObject | None:
    found = known.candidate
    place = known.place or (found.place if found else None)
    if place is None:
        return None
    state = known.state if known.place is not None else State.RELOCATING
    return VisualObject(
        object_id=known.object_id,
        name=known.name,
        x=place.x,
        y=place.y,
        covariance=np.array([place.xx, place.xy, place.xy, place.yy]),
        reliability=known.reliability,
        state=int(state),
        evidence_count=known.evidence_count,
        candidate_x=found.place.x if found else math.nan,
        candidate_y=found.place.y if found else math.nan,
        candidate_reliability=found.reliability if found else 0.0,
    )
