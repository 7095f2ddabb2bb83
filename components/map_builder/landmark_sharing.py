"""The landmarks that a shared record amounts to, and what this robot contributes to it.

`shared_landmark` is a pure function of the record: equal records give equal landmarks, bit by bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace

from cairn.components.map_builder.evidence_chain import time_text
from cairn.components.map_builder.landmark_registration import record_arrival, record_departure
from cairn.components.map_builder.pose_reliability import LEAST, MOST, REMOVAL
from cairn.visual_map.landmarks import (
    CANDIDATE_RELIABILITY,
    FARTHEST_M,
    NO_VIEWPOINTS,
    ChangeKind,
    LandmarkChange,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
    new_landmark,
)
from cairn.visual_map.shared_record import (
    MOST_INFORMATION,
    MOST_LOG_ODDS,
    MOST_STAMP_NS,
    NO_INFORMATION,
    ORIGINAL,
    Contribution,
    Life,
    PositionInformation,
    SharedRecord,
)

# A position of smaller determinant [m^4] is exact: observations do not improve it.
_EXACT = 1e-16
_NO_LARGER = 1.0 + 1e-6  # up to rounding
# A landmark within this distance of its position has not moved [m]; as in registration.
_UNMOVED_M = 0.35
# A difference of positions [m] that is not published as a change; as of a refinement.
_SAME_M = 0.01


@dataclass(frozen=True)
class SharedLandmark:
    """What a record knows about a landmark: where it stands, or last stood, and how reliably.

    `robots` are those that contributed to this life. `removed_by` is the one that found it gone
    last; None if the sum of all evidence removed it, or if it stands. `stamp_ns` is the time of the
    newest evidence, by the clock of the robot that has it [ns].
    """

    life: Life
    position: MapPosition
    reliability: float
    state: LandmarkState
    robots: tuple[str, ...]
    stamp_ns: int
    removed_by: str | None = None


def shared_landmark(
    record: SharedRecord, object_id: int, original: MapPosition | None, prior: float
) -> SharedLandmark | None:
    """Return what a record knows about an object; None if nothing, or if it has no position.

    Args:
        record: The contributions of all robots.
        object_id: The object.
        original: Its position in the map from which all robots started, None if it has none there.
        prior: Its reliability there.
    """
    about = record.about(object_id)
    if not about:
        return None
    life = about[0].life
    begin = _begin(about, original)
    if begin is None:
        return None
    odds = _prior_odds(life, prior) + sum(one.log_odds for one in about)
    reliability = min(MOST, max(LEAST, _probability(odds)))
    removals = [one for one in about if one.removed]
    newest = max(removals or about, key=lambda one: (one.stamp_ns, one.robot))
    is_gone = bool(removals) or reliability <= REMOVAL
    if is_gone:
        reliability = min(reliability, CANDIDATE_RELIABILITY)
    return SharedLandmark(
        life,
        _improved(begin, _total(about)),
        reliability,
        LandmarkState.RELOCATING if is_gone else LandmarkState.LIVE,
        tuple(one.robot for one in about),
        newest.stamp_ns,
        newest.robot if removals else None,
    )


class LandmarkSharing:
    """This robot's part in the shared record of the landmarks of one map.

    `originals` are the landmarks of the map from which all robots started.
    """

    def __init__(
        self, robot: str, originals: Iterable[LandmarkRecord], contributions: Iterable[Contribution]
    ) -> None:
        self.robot = robot
        self.record = SharedRecord(contributions)
        self._originals = {one.object_id: one for one in originals}
        self._version = 0

    @property
    def next_version(self) -> int:
        """Return a version that no contribution of this robot has had."""
        return min(max(self._version + 1, self.record.next_version(self.robot)), MOST_STAMP_NS)

    def landmark(self, object_id: int) -> SharedLandmark | None:
        """Return what the record knows about an object, None if nothing."""
        original = self._original_position(object_id)
        return shared_landmark(self.record, object_id, original, self._prior(object_id))

    def contribute(
        self, landmark: LandmarkRecord, stamp_ns: int, *, registered: bool
    ) -> Contribution | None:
        """Add what this robot has found out about a landmark; return it, None if nothing is new.

        The record then gives `landmark`, as it is after the robot's own evidence, to within
        rounding. `registered`: the landmark has been registered or restored at its position.
        """
        now = self._present(landmark.object_id)
        if registered and landmark.state is LandmarkState.LIVE and landmark.position is not None:
            return self._add(self._begun(landmark, landmark.position, stamp_ns))
        if now is None or now.state is LandmarkState.RELOCATING:
            return None  # it was never shared, or what is known is a candidate, each robot's own
        former = self._own(landmark.object_id, stamp_ns)
        own, others = former, self._others(landmark.object_id)
        if landmark.reliability != now.reliability:
            odds = _prior_odds(now.life, self._prior(landmark.object_id))
            odds += sum(one.log_odds for one in others)
            own = replace(own, log_odds=_log_odds(landmark.reliability) - odds)
        begin = _begin([own], self._original_position(landmark.object_id))
        if landmark.position is not None and landmark.position != now.position and begin:
            whole = _information(begin, landmark.position)
            added = NO_INFORMATION if whole is None else whole.plus(_total(others), -1.0)
            own = replace(own, information=added)
        if landmark.state is LandmarkState.RELOCATING:
            own = replace(own, removed=True)
        if own == former:
            return None
        absurd = max(map(abs, astuple(own.information))) > MOST_INFORMATION
        if (absurd or abs(own.log_odds) > MOST_LOG_ODDS) and landmark.position is not None:
            # Others would not accept it. It makes up for a contribution that no robot makes, which
            # a new life ends.
            own = self._begun(landmark, landmark.position, stamp_ns)
            own = replace(own, removed=landmark.state is LandmarkState.RELOCATING)
        return self._add(own)

    def adopted(
        self,
        landmark: LandmarkRecord | None,
        object_id: int,
        before: SharedLandmark | None,
        now_s: float,
    ) -> tuple[LandmarkRecord, LandmarkChange | None] | None:
        """Return a landmark as the record knows it, and the change; None if it is that already.

        Args:
            landmark: As it is in this robot's map; None if it is not there.
            object_id: The object.
            before: What the record knew when the landmark was last adopted.
            now_s: The time by this robot's clock [s].
        """
        shared = self.landmark(object_id)
        if shared is None:
            return None
        known = new_landmark(object_id) if landmark is None else landmark
        same = (
            known.position == shared.position
            and known.reliability == shared.reliability
            and known.state is shared.state
        )
        if same:
            return None
        moved = replace(
            known,
            position=shared.position,
            reliability=shared.reliability,
            state=shared.state,
        )
        old_life = ORIGINAL if before is None else before.life
        if shared.state is known.state and shared.life == old_life:
            return moved, _refinement(known, shared)
        moved = replace(
            moved,
            candidate=None,
            judged_from=None,
            missed_from=None,
            viewpoints=NO_VIEWPOINTS,
            uncorroborated=0,
        )
        # As for the robot's own changes: two things that look alike are noticed by both robots. Two
        # robots that register one object at nearly one position are no such thing.
        old, both_live = known.position, known.state is shared.state is LandmarkState.LIVE
        if both_live and old is not None and old.distance(shared.position) <= _UNMOVED_M:
            return moved, _described(known, shared)
        if old is not None and known.state is LandmarkState.LIVE:
            moved = replace(moved, history=record_departure(known.history, old, now_s))
        if shared.state is LandmarkState.LIVE:
            moved = replace(moved, history=record_arrival(moved.history, shared.position, now_s))
        return moved, _described(known, shared)

    def _present(self, object_id: int) -> SharedLandmark | None:
        """Return what the record knows; without contributions, what the original map has."""
        known = self.landmark(object_id)
        original = self._originals.get(object_id)
        if known is not None or original is None or original.position is None:
            return known
        return SharedLandmark(
            ORIGINAL, original.position, original.reliability, original.state, (), 0
        )

    def _prior(self, object_id: int) -> float:
        original = self._originals.get(object_id)
        return CANDIDATE_RELIABILITY if original is None else original.reliability

    def _original_position(self, object_id: int) -> MapPosition | None:
        original = self._originals.get(object_id)
        return None if original is None else original.position

    def _own(self, object_id: int, stamp_ns: int) -> Contribution:
        """Return this robot's contribution to the present life, an empty one if it has none."""
        about = self.record.about(object_id)
        for one in about:
            if one.robot == self.robot:
                return replace(one, stamp_ns=max(one.stamp_ns, stamp_ns))
        life = about[0].life if about else ORIGINAL
        registered = _begin(about, None)
        return Contribution(
            self.robot, object_id, 1, stamp_ns, life, registered, removed=False, log_odds=0.0
        )

    def _others(self, object_id: int) -> list[Contribution]:
        return [one for one in self.record.about(object_id) if one.robot != self.robot]

    def _begun(
        self, landmark: LandmarkRecord, position: MapPosition, stamp_ns: int
    ) -> Contribution:
        """Return the contribution with which a new life begins, later than all known ones."""
        about = self.record.about(landmark.object_id)
        latest = about[0].life if about else ORIGINAL
        began_ns = min(max(stamp_ns, latest.began_ns + 1), MOST_STAMP_NS)
        life = Life(began_ns, self.robot)
        return Contribution(
            self.robot,
            landmark.object_id,
            1,
            stamp_ns,
            life,
            position,
            removed=False,
            log_odds=_log_odds(landmark.reliability),
        )

    def _add(self, one: Contribution) -> Contribution:
        self._version = self.next_version
        numbered = replace(one, version=self._version)
        self.record.merge([numbered])
        return numbered


def _begin(about: Iterable[Contribution], original: MapPosition | None) -> MapPosition | None:
    """Return the position at which a life began, which all that contribute to it state.

    `original` is that in the original map.
    """
    stated = max((one.registered for one in about), key=_place, default=None)
    return original if stated is None else stated


def _place(position: MapPosition | None) -> tuple[float, ...]:
    return () if position is None else astuple(position)


def _prior_odds(life: Life, prior: float) -> float:
    # A life that a robot began has its evidence in that robot's contribution.
    return _log_odds(prior) if life == ORIGINAL else 0.0


def _log_odds(reliability: float) -> float:
    p = min(MOST, max(LEAST, reliability))
    return math.log(p / (1.0 - p))


def _probability(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-min(700.0, max(-700.0, log_odds))))


def _total(contributions: Iterable[Contribution]) -> PositionInformation:
    total = NO_INFORMATION
    for one in contributions:
        total = total.plus(one.information)
    return total


def _information(begin: MapPosition, position: MapPosition) -> PositionInformation | None:
    """Return the information that leads from the begin of a life to a position.

    None if one of them is exact.
    """
    prior, now = _inverse(begin), _inverse(position)
    if prior is None or now is None:
        return None
    dx, dy = position.x - begin.x, position.y - begin.y
    (ixx, ixy, iyy), (pxx, pxy, pyy) = now, prior
    return PositionInformation(
        ixx - pxx, ixy - pxy, iyy - pyy, ixx * dx + ixy * dy, ixy * dx + iyy * dy
    )


def _improved(begin: MapPosition, added: PositionInformation) -> MapPosition:
    """Return the position at which a life began, improved by all that robots have observed."""
    prior = _inverse(begin)
    if prior is None or added == NO_INFORMATION:
        return begin
    xx, xy, yy = prior[0] + added.xx, prior[1] + added.xy, prior[2] + added.yy
    sums = MapPosition(0.0, 0.0, xx, xy, yy)
    covariance = _inverse(sums) if xx > 0.0 and yy > 0.0 else None
    if covariance is None:  # no robot's evidence adds up to that
        return begin
    cxx, cxy, cyy = covariance
    if cxx > begin.xx * _NO_LARGER or cyy > begin.yy * _NO_LARGER:
        return begin  # evidence only adds information; forged contributions may remove it
    x = begin.x + cxx * added.x + cxy * added.y
    y = begin.y + cxy * added.x + cyy * added.y
    if not (abs(x) <= FARTHEST_M and abs(y) <= FARTHEST_M):
        return begin
    return MapPosition(x, y, cxx, cxy, cyy)


def _inverse(one: MapPosition) -> tuple[float, float, float] | None:
    """Return the inverse of a covariance, None if it is singular."""
    determinant = one.xx * one.yy - one.xy * one.xy
    if not _EXACT < determinant < math.inf:
        return None
    return one.yy / determinant, -one.xy / determinant, one.xx / determinant


def _refinement(known: LandmarkRecord, shared: SharedLandmark) -> LandmarkChange | None:
    old = known.position
    moved_m = math.inf if old is None else old.distance(shared.position)
    if moved_m < _SAME_M or shared.state is LandmarkState.RELOCATING:
        return None
    reason = f"observations of {_names(shared.robots)} moved it by {moved_m:.3f} m"
    return LandmarkChange(
        known.object_id, ChangeKind.REFINED, old, shared.position, shared.reliability, reason
    )


def _described(known: LandmarkRecord, shared: SharedLandmark) -> LandmarkChange | None:
    """Return the change by which a landmark becomes what the record knows."""
    old = known.position
    kind, new = ChangeKind.REGISTERED, shared.position
    if shared.state is LandmarkState.RELOCATING:
        if known.state is LandmarkState.RELOCATING:
            return None
        by = shared.removed_by
        reason = (
            f"the evidence of {_names(shared.robots)} together removed it"
            if by is None
            else f"{by} found at {time_text(shared.stamp_ns)} that it is no longer there"
        )
        return LandmarkChange(
            known.object_id, ChangeKind.REMOVED, old, None, shared.reliability, reason
        )
    robot = shared.life.robot or _names(shared.robots)
    reason = f"{robot} registered it at its new position, at {time_text(shared.life.began_ns)}"
    if old is not None and old.distance(new) <= _SAME_M:
        if known.state is LandmarkState.LIVE:
            return None
        kind = ChangeKind.RESTORED
        reason = f"{robot} found that it stands at its position"
    return LandmarkChange(known.object_id, kind, old, new, shared.reliability, reason)


def _names(robots: Iterable[str]) -> str:
    return ", ".join(robots)
