"""What an emulated PBS-03JN sees: a corner of a room that somebody walks through."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs.messages import RAYS

NOTHING_MM = 0xFFFF
"""Told where no light comes back."""

_SIGHT_MM = 4000.0
_ANGLES = math.radians(1.8) * (np.arange(RAYS) - (RAYS - 1) // 2)


def room(seed: int, turn: int, began_s: float) -> NDArray[np.uint16]:
    """Distances [mm] of all rays in a turn, from right to left; no two turns are alike."""
    ahead, left = np.cos(_ANGLES), np.sin(_ANGLES)
    with np.errstate(divide="ignore"):
        walls = np.minimum(
            np.where(ahead > 0, 2400.0, 6000.0) / np.abs(ahead),
            np.where(left > 0, 1900.0, 6000.0) / np.abs(left),
        )
    beside = _ANGLES - 0.9 * math.sin(0.5 * began_s)  # the walker: 1.3 m away, 0.5 m wide
    within = (np.abs(1300.0 * np.sin(beside)) < 250.0) & (np.cos(beside) > 0)
    found = np.where(within, np.minimum(walls, 1100.0), walls)
    random = np.random.default_rng((seed, turn))
    measured = found * (1.0 + random.normal(0.0, 0.01, RAYS))
    return np.where(found > _SIGHT_MM, NOTHING_MM, measured).astype(np.uint16)
