"""A persistence filter, to compare with: D. M. Rosen, J. Mason, J. J. Leonard, Towards lifelong
feature-based mapping in semi-static environments, ICRA 2016.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from cairn.components.map_builder.candidate import ANOTHER_M, ANOTHER_RAD, judge_candidate
from cairn.components.map_builder.objects import Change, Evidence, Kind, MapObject, State, Verdict
from cairn.planar.poses import apart

_REMOVAL = 0.1
# Inside this normalized distance (2 dof, 99 %) a sighting is a detection of the mapped feature.
_DETECTED = 3.03
_LEAST, _MOST = 1e-6, 1.0 - 1e-6


@dataclass
class PersistenceFilter:
    """Belief that a feature still stands where it was mapped, as `MapObject.reliability`.

    `missed` is the chance that a feature which stands is not detected, `false` that one which is
    gone is. Features are taken to stand for `lifetime_s` [s] on average: with this exponential
    prior the filter's sums over past observations reduce to a recursion.
    """

    missed: float = 0.3
    false: float = 0.02
    lifetime_s: float = 600.0
    _observed_s: dict[int, float] = field(default_factory=dict)

    def __call__(
        self, known: MapObject, evidence: Evidence, now_s: float
    ) -> tuple[MapObject, Change | None]:
        """What `evidence` at `now_s` [s] makes of an object."""
        if known.state is not State.LIVE:
            if evidence.verdict is Verdict.UNSEEN:
                return known, None
            return judge_candidate(known, evidence, now_s)
        if not evidence.healthy:
            return known, None
        if known.judged_from is not None and not apart(
            known.judged_from, evidence.robot, ANOTHER_M, ANOTHER_RAD
        ):
            return known, None
        detected = evidence.verdict is not Verdict.UNSEEN and evidence.distance <= _DETECTED
        waited_s = now_s - self._observed_s.get(known.object_id, now_s)
        self._observed_s[known.object_id] = now_s
        belief = self._updated(known.reliability, detected, waited_s)
        judged = replace(
            known,
            reliability=belief,
            evidence_count=known.evidence_count + 1,
            judged_from=evidence.robot,
        )
        if belief > _REMOVAL:
            return judged, None
        reason = f"its persistence fell to {belief:.2f}"
        removed = replace(judged, state=State.RELOCATING, candidate=None)
        change = Change(known.object_id, Kind.REMOVED, known.place, None, belief, reason)
        return removed, change

    def _updated(self, belief: float, detected: bool, waited_s: float) -> float:
        """Bayes' rule for one observation, after the belief has faded for `waited_s` [s]."""
        prior = belief * math.exp(-max(0.0, waited_s) / self.lifetime_s)
        there = 1.0 - self.missed if detected else self.missed
        gone = self.false if detected else 1.0 - self.false
        belief = prior * there / (prior * there + (1.0 - prior) * gone)
        return min(_MOST, max(_LEAST, belief))
