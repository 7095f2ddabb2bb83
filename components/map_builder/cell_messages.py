"""Messages of the cells of the grid map that robots share."""

from __future__ import annotations

from cairn.components.map_builder.cell_record import (
    Decision,
    Tiles,
    check_decision,
    from_bytes,
    to_bytes,
)
from cairn.components.map_builder.record_exchange import MOST_AHEAD_NS, Exchange
from cairn.schemas.cairn_msgs import MOST_DECISIONS, CellDecision

CellExchange = Exchange[CellDecision, Decision]


def cell_exchange(robot: str, map_digest: str, tiles: Tiles) -> CellExchange:
    """Return a robot's exchange of what is known about the cells of a map."""

    def accepted(sent: CellDecision, now_ns: int) -> Decision:
        try:
            one = decision_of(sent)
            check_decision(one, tiles)
            if one.stamp_ns > now_ns + MOST_AHEAD_NS:
                raise ValueError("it is of more than a day from now; check the clocks")
        except ValueError as error:
            raise ValueError(f"of {sent.robot!r} about tile {sent.tile}: {error}") from error
        return one

    return Exchange(robot, map_digest, MOST_DECISIONS, accepted)


def decision_message(one: Decision) -> CellDecision:
    """Return the message of a decision."""
    return CellDecision(
        robot=one.robot,
        tile=one.tile,
        stamp=one.stamp_ns,
        free=to_bytes(one.free),
        occupied=to_bytes(one.occupied),
        unknown=to_bytes(one.unknown),
    )


def decision_of(message: CellDecision) -> Decision:
    """Return the decision in a message, which may be invalid."""
    return Decision(
        message.robot,
        message.tile,
        message.stamp,
        free=from_bytes(message.free),
        occupied=from_bytes(message.occupied),
        unknown=from_bytes(message.unknown),
    )
