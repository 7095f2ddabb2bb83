"""Messages of landmarks: evidence about them, the visual map, its changes, what robots share."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from cairn.components.map_builder.record_exchange import MOST_AHEAD_NS, Exchange
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import (
    MOST_CONTRIBUTIONS,
    LandmarkContribution,
    ObjectEvidenceArray,
    VisualMap,
    VisualMapChange,
    VisualObject,
)
from cairn.schemas.std_msgs import Header
from cairn.visual_map.landmarks import (
    EvidenceVerdict,
    LandmarkChange,
    LandmarkEvidence,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
)
from cairn.visual_map.shared_record import (
    ORIGINAL,
    Contribution,
    Life,
    PositionInformation,
    check_contribution,
)

LandmarkExchange = Exchange[LandmarkContribution, Contribution]


def landmark_exchange(robot: str, map_digest: str) -> LandmarkExchange:
    """Return a robot's exchange of what is known about the landmarks of a map."""
    return Exchange(robot, map_digest, MOST_CONTRIBUTIONS, _accepted)


def contribution_message(one: Contribution) -> LandmarkContribution:
    """Return the message of a contribution."""
    at, found = one.registered, one.information
    return LandmarkContribution(
        robot=one.robot,
        object_id=one.object_id,
        version=one.version,
        stamp=one.stamp_ns,
        began=one.life.began_ns,
        began_by=one.life.robot,
        x=math.nan if at is None else at.x,
        y=math.nan if at is None else at.y,
        covariance=np.zeros(4) if at is None else np.array([at.xx, at.xy, at.xy, at.yy]),
        removed=one.removed,
        log_odds=one.log_odds,
        information=np.array([found.xx, found.xy, found.yy, found.x, found.y]),
    )


def contribution_of(message: LandmarkContribution) -> Contribution:
    """Return the contribution in a message, which may be invalid."""
    xx, xy, _, yy = message.covariance.tolist()
    life = Life(message.began, message.began_by)
    return Contribution(
        robot=message.robot,
        object_id=message.object_id,
        version=message.version,
        stamp_ns=message.stamp,
        life=life,
        registered=(
            None
            if life == ORIGINAL and math.isnan(message.x)
            else MapPosition(message.x, message.y, xx, xy, yy)
        ),
        removed=message.removed,
        log_odds=message.log_odds,
        information=PositionInformation(*message.information.tolist()),
    )


def _accepted(sent: LandmarkContribution, now_ns: int) -> Contribution:
    try:
        one = contribution_of(sent)
        check_contribution(one)
        if one.life.began_ns > now_ns + MOST_AHEAD_NS:
            raise ValueError("its life begins more than a day from now; check the clocks")
    except ValueError as error:
        raise ValueError(f"of {sent.robot!r} about object {sent.object_id}: {error}") from error
    return one


def evidence_of(message: ObjectEvidenceArray) -> list[LandmarkEvidence]:
    """Return the evidence in a message."""
    robot = (message.robot_x, message.robot_y, message.robot_theta)
    return [
        LandmarkEvidence(
            object_id=piece.object_id,
            similarity=piece.similarity,
            verdict=EvidenceVerdict(piece.verdict),
            distance=piece.distance,
            implied=MapPosition(
                piece.x,
                piece.y,
                float(piece.covariance[0]),
                float(piece.covariance[1]),
                float(piece.covariance[3]),
            ),
            robot=robot,
            healthy=message.healthy,
            corroborated=piece.corroborated,
        )
        for piece in message.evidence
    ]


def landmark_of(message: VisualObject) -> LandmarkRecord:
    """Return the landmark of a message, as new in the map."""
    xx, xy, _, yy = message.covariance.tolist()
    position = MapPosition(message.x, message.y, xx, xy, yy)
    return LandmarkRecord(message.object_id, message.name, position, message.reliability)


def map_message(stamp: Time, version: int, landmarks: Iterable[LandmarkRecord]) -> VisualMap:
    """Return the message of all landmarks; one without a position is at its candidate."""
    messages = map(_object_message, landmarks)
    return VisualMap(
        header=Header(stamp=stamp, frame_id="map"),
        version=version,
        objects=tuple(message for message in messages if message is not None),
    )


def change_message(stamp: Time, version: int, change: LandmarkChange) -> VisualMapChange:
    """Return the message of one change; a removed landmark has no new position."""
    old, new = change.old, change.new
    return VisualMapChange(
        header=Header(stamp=stamp, frame_id="map"),
        version=version,
        object_id=change.object_id,
        kind=int(change.kind),
        old_x=old.x if old else math.nan,
        old_y=old.y if old else math.nan,
        new_x=new.x if new else math.nan,
        new_y=new.y if new else math.nan,
        reliability=change.reliability,
        reason=change.reason,
    )


def _object_message(landmark: LandmarkRecord) -> VisualObject | None:
    found = landmark.candidate
    position = landmark.position or (found.position if found else None)
    if position is None:
        return None
    state = landmark.state if landmark.position is not None else LandmarkState.RELOCATING
    return VisualObject(
        object_id=landmark.object_id,
        name=landmark.name,
        x=position.x,
        y=position.y,
        covariance=np.array([position.xx, position.xy, position.xy, position.yy]),
        reliability=landmark.reliability,
        state=int(state),
        evidence_count=landmark.evidence_count,
        candidate_x=found.position.x if found else math.nan,
        candidate_y=found.position.y if found else math.nan,
        candidate_reliability=found.reliability if found else 0.0,
    )
