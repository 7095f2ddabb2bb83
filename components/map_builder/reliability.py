"""Updates the pose reliability of a landmark by a similarity: equation (2) of the paper."""

from __future__ import annotations

import math

from cairn.visual_map.landmarks import INITIAL_RELIABILITY

LEAST, MOST = 0.02, 0.98
# A landmark at or under this is removed; 1e-9 because two disagreements bring 0.9 to 0.1 exactly.
REMOVAL = 0.1 + 1e-9
# A candidate above this is registered: one agreement brings it to 0.5 exactly, two register it.
REGISTRATION = 0.5 + 1e-9


def update(reliability: float, similarity: float) -> float:
    """Apply equation (2), limited to [0.02, 0.98] so that no verdict is final.

    Both arguments are in [0, 1]. Similarities of 0 and 1 are absorbing in the paper's form, so they
    count as 0.1 and 0.9.
    """
    s = min(0.9, max(0.1, similarity))
    p = min(MOST, max(LEAST, reliability))
    agreeing = s * p
    updated = agreeing / (agreeing + (1.0 - s) * (1.0 - p))
    if math.isnan(updated):
        return INITIAL_RELIABILITY
    return min(MOST, max(LEAST, updated))
