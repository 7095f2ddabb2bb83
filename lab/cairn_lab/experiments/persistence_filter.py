"""A persistence filter, for comparison with the reliability rule.

D. M. Rosen, J. Mason, J. J. Leonard, Towards lifelong feature-based mapping in semi-static
environments, ICRA 2016.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from cairn.components.map_builder.landmark_registration import (
    INDEPENDENT_M,
    INDEPENDENT_RAD,
    judge_candidate,
)
from cairn.planar.poses import apart
from cairn.visual_map.landmarks import (
    ChangeKind,
    EvidenceVerdict,
    LandmarkChange,
    LandmarkEvidence,
    LandmarkRecord,
    LandmarkState,
)

_REMOVAL = 0.1  # as in the paper's rule, for comparison
# Normalized distance within which an observation detects the mapped feature: the root of
# scipy.stats.chi2.ppf(0.99, 2).
_DETECTED = 3.03
_LEAST, _MOST = 1e-6, 1.0 - 1e-6  # the belief stays changeable


@dataclass
class PersistenceFilter:
    """The belief that a feature is still at its position, as `LandmarkRecord.reliability`.

    `missed` is the probability of not detecting a present feature, `false` that of detecting an
    absent one. Features persist for `lifetime_s` [s] on average: with this exponential prior the
    filter's sums over past observations reduce to a recursion. The defaults are not tuned.
    """

    missed: float = 0.3
    false: float = 0.02
    lifetime_s: float = 600.0
    _observed_s: dict[int, float] = field(default_factory=dict)

    def __call__(
        self, landmark: LandmarkRecord, evidence: LandmarkEvidence, now_s: float
    ) -> tuple[LandmarkRecord, LandmarkChange | None]:
        """Update a landmark by evidence at `now_s` [s]."""
        if landmark.state is not LandmarkState.LIVE:
            if evidence.verdict is EvidenceVerdict.UNSEEN:
                return landmark, None
            return judge_candidate(landmark, evidence, now_s)
        if not evidence.healthy:
            return landmark, None
        if landmark.judged_from is not None and not apart(
            landmark.judged_from, evidence.robot, INDEPENDENT_M, INDEPENDENT_RAD
        ):
            return landmark, None
        detected = evidence.verdict is not EvidenceVerdict.UNSEEN and evidence.distance <= _DETECTED
        waited_s = now_s - self._observed_s.get(landmark.object_id, now_s)
        self._observed_s[landmark.object_id] = now_s
        belief = self._updated(landmark.reliability, detected, waited_s)
        judged = replace(
            landmark,
            reliability=belief,
            evidence_count=landmark.evidence_count + 1,
            judged_from=evidence.robot,
        )
        if belief > _REMOVAL:
            return judged, None
        reason = f"its persistence fell to {belief:.2f}"
        removed = replace(judged, state=LandmarkState.RELOCATING, candidate=None)
        change = LandmarkChange(
            landmark.object_id, ChangeKind.REMOVED, landmark.position, None, belief, reason
        )
        return removed, change

    def _updated(self, belief: float, detected: bool, waited_s: float) -> float:
        """Apply Bayes' rule for one observation, after the belief decayed for `waited_s` [s]."""
        prior = belief * math.exp(-max(0.0, waited_s) / self.lifetime_s)
        present = 1.0 - self.missed if detected else self.missed
        absent = self.false if detected else 1.0 - self.false
        belief = prior * present / (prior * present + (1.0 - prior) * absent)
        return min(_MOST, max(_LEAST, belief))
