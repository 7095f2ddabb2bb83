"""A room with a box in it, as a scanner sees it, and a drive through it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cairn.components.slam.mapping import Mapper
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays

ANGLES = np.linspace(-2.0, 2.0, 181)
SECOND = 1_000_000_000


BOXES = ((-1.0, -1.0, 5.0, 3.0), (2.5, 1.2, 3.1, 1.8))
"""A room of 6 m x 4 m with a box in it: left, bottom, right, top [m]."""


def scan(pose: Pose, boxes: Sequence[tuple[float, float, float, float]] = BOXES) -> Rays:
    """Return what a scanner sees from a pose in a room."""
    x, y, theta = pose
    ranges = np.full(ANGLES.size, np.inf)
    for left, bottom, right, top in boxes:
        for k, angle in enumerate(ANGLES + theta):
            cosine, sine = math.cos(angle), math.sin(angle)
            for edge in (left, right):
                along = (edge - x) / cosine if cosine else -1.0
                if along > 0 and bottom <= y + along * sine <= top:
                    ranges[k] = min(ranges[k], along)
            for edge in (bottom, top):
                along = (edge - y) / sine if sine else -1.0
                if along > 0 and left <= x + along * cosine <= right:
                    ranges[k] = min(ranges[k], along)
    return Rays(np.zeros((ANGLES.size, 2)), ANGLES, ranges, 10.0)


def drive(
    mapper: Mapper,
    begin: int,
    end: int,
    boxes: Sequence[tuple[float, float, float, float]] = BOXES,
) -> None:
    """Add the scans of a straight way through a room, at 0.1 m per scan."""
    for k in range(begin, end):
        pose = (0.1 * k, 0.0, 0.0)
        mapper.add_scan(k * SECOND, pose, scan(pose, boxes))
