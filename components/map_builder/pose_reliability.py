"""Updates the pose reliability of a landmark by a similarity: equation (2) of the paper."""

from __future__ import annotations

import math

from cairn.visual_map.landmarks import INITIAL_RELIABILITY

# The limits keep a landmark changeable: three disagreements (0.1) remove one of 0.98; without
# limits one of 0.9999 would need six.
LEAST, MOST = 0.02, 0.98
# The limits of a similarity. The paper shows 0.5 -> 0.9 after one evaluation (figures 7 and 10):
# its similarities were at most 0.9.
LEAST_SIMILARITY, MOST_SIMILARITY = 0.1, 0.9
# A landmark at or under this is removed (the paper, section 3.2); 1e-9 because two disagreements
# bring 0.9 to 0.1 exactly.
REMOVAL = 0.1 + 1e-9
# A candidate above this is registered (the paper, section 3.2): one agreement brings it to 0.5
# exactly, two register it.
REGISTRATION = 0.5 + 1e-9


def update(reliability: float, similarity: float) -> float:
    """Apply equation (2), limited to [0.02, 0.98] so that no verdict is final.

    Both arguments are in [0, 1]. Similarities of 0 and 1 are absorbing in the paper's form, so they
    count as 0.1 and 0.9.
    """
    s = min(MOST_SIMILARITY, max(LEAST_SIMILARITY, similarity))
    p = min(MOST, max(LEAST, reliability))
    agreeing = s * p
    updated = agreeing / (agreeing + (1.0 - s) * (1.0 - p))
    if math.isnan(updated):
        return INITIAL_RELIABILITY
    return min(MOST, max(LEAST, updated))
