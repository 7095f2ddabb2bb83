"""Which cells of a grid a ray passes."""

from __future__ import annotations

import math

from cairn.planar.compiled import compiled


@compiled()
def first_step(begin: float, direction: float) -> tuple[int, float, float]:
    """Along one axis, in cells: the step of the index, and after what share of the ray the first
    and every further border is crossed (Amanatides and Woo 1987).
    """
    cell = math.floor(begin)
    if direction > 0.0:
        return 1, (cell + 1.0 - begin) / direction, 1.0 / direction
    if direction < 0.0:
        return -1, (cell - begin) / direction, -1.0 / direction
    return 0, math.inf, math.inf
