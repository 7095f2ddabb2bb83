"""Messages of the landmarks that robots share."""

from __future__ import annotations

import math

import numpy as np

from cairn.components.map_builder.record_exchange import MOST_AHEAD_NS, Exchange
from cairn.schemas.cairn_msgs import MOST_CONTRIBUTIONS, LandmarkContribution
from cairn.visual_map.landmarks import MapPosition
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
