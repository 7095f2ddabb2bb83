"""The rows of the map file's tables, and the objects they stand for."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

from cairn.components.map_builder.objects import (
    Candidate,
    Change,
    Evidence,
    MapObject,
    State,
)
from cairn.components.map_builder.place import Place
from cairn.components.map_builder.viewpoints import NOWHERE, Cell, Viewpoints
from cairn.visual_map.file import check_row, row_checksum

Row = tuple[Any, ...]

_MOST = 2**32 - 1  # as a message can carry

# A candidate read from a file was seen by a robot whose pose then is of no use now: the next
# sighting counts as made from another pose.
_ELSEWHERE = (float("inf"), float("inf"), 0.0)


def object_row(known: MapObject) -> Row:
    """The row of table `objects`."""
    found = known.candidate
    row = (
        known.object_id,
        known.name,
        *_place_row(known.place),
        known.reliability,
        int(known.state),
        known.evidence_count,
        *_place_row(found.place if found else None),
        found.reliability if found else None,
        found.sightings if found else None,
        json.dumps(asdict(known.viewpoints)),
    )
    return (*row, row_checksum(row))


def object_from_row(row: Row) -> MapObject:
    """The object of a row of table `objects`.

    Raises `ValueError` naming the object and the value if the row holds what no object can have.
    """
    try:
        candidate_place = _place(row[10:15])
        candidate = None
        if candidate_place is not None:
            sightings = _within("candidate_sightings", int(row[16]), 0, _MOST)
            candidate = Candidate(candidate_place, _probability(row[15]), sightings, _ELSEWHERE)
        if "\0" in str(row[1]):
            raise ValueError("name holds a NUL")
        found = MapObject(
            object_id=_within("object_id", int(row[0]), 0, _MOST),
            name=str(row[1]),
            place=_place(row[2:7]),
            reliability=_probability(row[7]),
            state=State(row[8]),
            evidence_count=_within("evidence_count", int(row[9]), 0, _MOST),
            candidate=candidate,
            viewpoints=_viewpoints(str(row[17])),
        )
        check_row(row[:18], row[18])
        return found
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(f"object {row[0]}: {error}") from error


def change_row(version: int, stamp_ns: int, change: Change) -> Row:
    """The row of table `changes`."""
    old, new = change.old, change.new
    return (
        version,
        stamp_ns,
        change.object_id,
        change.kind.name,
        old.x if old else None,
        old.y if old else None,
        new.x if new else None,
        new.y if new else None,
        change.reliability,
        change.reason,
    )


def evidence_row(stamp_ns: int, evidence: Evidence, after: MapObject, counted: bool) -> Row:
    """The row of table `evidence`: what was seen, and what it left of the object."""
    return (
        stamp_ns,
        evidence.object_id,
        evidence.weight,
        evidence.verdict.name,
        evidence.distance,
        *_place_row(evidence.implied),
        *evidence.robot,
        int(evidence.healthy),
        int(counted),
        after.reliability,
        after.candidate.reliability if after.candidate else None,
        int(after.state),
    )


def _place_row(place: Place | None) -> Row:
    if place is None:
        return (None,) * 5
    return place.x, place.y, place.xx, place.xy, place.yy


def _place(values: Row) -> Place | None:
    if values[0] is None:
        return None
    place = Place(*(float(value) for value in values))
    if not all(map(math.isfinite, (place.x, place.y, place.xx, place.xy, place.yy))):
        raise ValueError(f"its place holds {values}, which are not finite numbers")
    if place.xx < 0 or place.yy < 0 or place.xy**2 > place.xx * place.yy * (1 + 1e-9):
        raise ValueError(f"({place.xx}, {place.xy}, {place.yy}) is no covariance of its place")
    return place


def _viewpoints(text: str) -> Viewpoints:
    if not text:
        return NOWHERE
    held = json.loads(text)

    def counts(name: str) -> tuple[tuple[Cell, int], ...]:
        return tuple(
            (_cell(cell), _within(f"number of times {name}", int(count), 0, _MOST))
            for cell, count in held[name]
        )

    return Viewpoints(counts("seen"), counts("missed"), tuple(map(_cell, held["absent"])))


def _cell(pair: Any) -> Cell:
    sector, band = pair
    return int(sector), int(band)


def _probability(value: Any) -> float:
    number = float(value)
    if not 0.0 <= number <= 1.0:
        raise ValueError(f"its reliability {number} is not between 0 and 1")
    return number


def _within(name: str, number: int, low: int, high: int) -> int:
    if not low <= number <= high:
        raise ValueError(f"its {name} {number} is not from {low} to {high}")
    return number
