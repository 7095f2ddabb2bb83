"""Viewpoints: from where a landmark was recognized, and so is expected to be seen again."""

from __future__ import annotations

import math
from dataclasses import replace

from cairn.planar.poses import Pose
from cairn.visual_map.landmarks import Cell, Viewpoints

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

# A cell of viewpoints: directions from the landmark to the robot, and bands of distance [m].
_SECTORS = 12
_BAND_M = 1.0
_MOST_BAND = 30  # the last band is endless: no camera recognizes a landmark from so far
# Counts are halved beyond this, so that recent ones outweigh old ones.
_MOST_COUNTS = 64
# A landmark that was recognized less often than this from a cell is not expected to be again.
_KNOWN_FROM = 3
# Probability of recognizing a landmark that is not there; benchmark `recognition` found none in 150
# pictures.
_FALSE_POSITIVE = 0.02
# Least similarity of a single absence: what hides a landmark now hides it a moment later, too.
_LEAST_SIMILARITY = 0.3


def add_recognition(viewpoints: Viewpoints, cell: Cell) -> Viewpoints:
    """Count a recognition from a cell; absences since the last one were misses."""
    missed = dict(viewpoints.missed)
    for one in viewpoints.absent:
        missed[one] = missed.get(one, 0) + 1
    seen = dict(viewpoints.seen)
    seen[cell] = seen.get(cell, 0) + 1
    if seen[cell] > _MOST_COUNTS:
        seen[cell] //= 2
        missed[cell] = missed.get(cell, 0) // 2
    return Viewpoints(tuple(sorted(seen.items())), tuple(sorted(missed.items())))


def add_absence(viewpoints: Viewpoints, cell: Cell) -> Viewpoints:
    """Record that the landmark was not recognized from a cell."""
    return replace(viewpoints, absent=(*viewpoints.absent, cell))


def similarity_of_absence(viewpoints: Viewpoints, cell: Cell) -> float | None:
    """Return the similarity of not being recognized from a cell, in [0, 0.5].

    It is the probability of missing a present landmark against that of not "recognizing" an absent
    one. None if the landmark is not known to be recognized from there.
    """
    seen = dict(viewpoints.seen).get(cell, 0)
    if seen < _KNOWN_FROM:
        return None
    missing = 1.0 - seen / (seen + dict(viewpoints.missed).get(cell, 0) + 1.0)
    return max(_LEAST_SIMILARITY, missing / (missing + 1.0 - _FALSE_POSITIVE))


def cell_of(x: float, y: float, robot: Pose) -> Cell:
    """Return the cell in which the robot sees a landmark at x, y [m]."""
    dx, dy = robot[0] - x, robot[1] - y
    sector = math.floor((math.atan2(dy, dx) + math.pi) / (2.0 * math.pi) * _SECTORS)
    band = min(math.hypot(dx, dy) / _BAND_M, _MOST_BAND)
    return min(sector, _SECTORS - 1), math.floor(band)
