"""Whether ranges by stereo and by size agree, and if not, what is wrong."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from itertools import groupby

import numpy as np

# The last so many sightings are looked at, of each object at least so many.
_WINDOW, _LEAST = 60, 8
SYSTEMATIC = 0.08
"""Sizes and photographs are never more exact than this share."""


class Agreement:
    """Ratios of ranges by stereo to those by size over many sightings."""

    def __init__(self) -> None:
        self._ratios: deque[tuple[str, float]] = deque(maxlen=_WINDOW)

    def add(self, name: str, ratio: float) -> str:
        """Take an object's next ratio; what is wrong, in words, or nothing."""
        self._ratios.append((name, ratio))
        by_object = {
            key: np.array([ratio for _, ratio in group])
            for key, group in groupby(sorted(self._ratios), key=lambda pair: pair[0])
        }
        medians = {
            key: float(np.median(ratios))
            for key, ratios in by_object.items()
            if len(ratios) >= _LEAST
        }
        return contradiction(name, medians)


def contradiction(name: str, ratios: Mapping[str, float]) -> str:
    """What is wrong about an object's range, in words, or nothing.

    `ratios` are those of the ranges by stereo to those by size of all objects, by name.
    """
    off = {key: ratio for key, ratio in ratios.items() if abs(ratio - 1) > SYSTEMATIC}
    if name not in off:
        return ""
    told = ", ".join(f"{100 * (ratio - 1):+.0f} % for {key}" for key, ratio in off.items())
    if len(ratios) > 1 and off.keys() == ratios.keys() and _on_one_side(off.values()):
        return (
            f"ranges by stereo differ from those by size ({told}): calibrate the cameras anew "
            "with `cairn camera calibrate`, or correct the objects' sizes"
        )
    return (
        f"ranges by stereo differ from those by size ({told}): tell the object's size by "
        f"`cairn object teach '{name}' --size W,H`; if it is right, calibrate the cameras anew"
    )


def _on_one_side(ratios: Iterable[float]) -> bool:
    return len({ratio > 1 for ratio in ratios}) == 1
