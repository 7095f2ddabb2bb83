"""Equation (2): the pose reliability of an object, from the similarities found so far."""

from __future__ import annotations

import math

LEAST, MOST = 0.02, 0.98
INITIAL = 0.5
# An object at or under this is removed; 1e-9 for 0.9 that two disagreements bring to 0.1 exactly.
REMOVAL = 0.1 + 1e-9
# A candidate place above this is registered: one agreement brings it to 0.5 exactly, two register.
REGISTRATION = 0.5 + 1e-9


def update(reliability: float, similarity: float) -> float:
    """Equation (2), kept within [0.02, 0.98] so that no verdict is final.

    Both in [0, 1]; similarities of 0 and 1 are absorbing in the paper's form and are taken as
    0.1 and 0.9 here.
    """
    s = min(0.9, max(0.1, similarity))
    p = min(MOST, max(LEAST, reliability))
    agreeing = s * p
    updated = agreeing / (agreeing + (1.0 - s) * (1.0 - p))
    if math.isnan(updated):
        return INITIAL
    return min(MOST, max(LEAST, updated))
