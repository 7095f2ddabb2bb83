"""Exchanges the shared record of landmarks with other robots: what to send, what to accept.

Each robot repeats a short summary of its record once a second. A robot that notices a difference
sends what the other may lack, so loss, duplication and reordering of messages, and days without
contact, only delay.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from cairn import SECOND, from_ns
from cairn.schemas.cairn_msgs import (
    MOST_CONTRIBUTIONS,
    LandmarkContribution,
    LandmarkContributor,
    SharedLandmarks,
)
from cairn.schemas.std_msgs import Header
from cairn.visual_map.landmarks import MapPosition
from cairn.visual_map.shared_record import (
    MOST_ROBOTS,
    ORIGINAL,
    Contribution,
    ContributorSummary,
    Life,
    PositionInformation,
    SharedRecord,
    check_contribution,
)

# A difference is answered again after this time [s]: the other has then had the time to receive the
# answer, and what it does not accept is not sent every second.
_AGAIN_S: Final = 5.0
# Answers are kept for so many differences, of all robots with all others.
_MOST_ANSWERED: Final = 4096
_AHEAD_NS: Final = 24 * 3600 * SECOND
"""A life that begins later than this after now [ns] is of a robot whose clock is wrong: it could
not be replaced by robots whose clocks are right, unless they know it."""


class Exchange:
    """What a robot sends of its record, and accepts for it."""

    def __init__(self, robot: str, map_digest: str) -> None:
        self.robot = robot
        self.map_digest = map_digest
        self.rejected = 0
        """Contributions that were not accepted."""
        self.reason = ""
        """Why the last one was not."""
        self._answers: deque[Contribution] = deque()
        self._answered: dict[tuple[str, str, int, int], int] = {}

    def accept(
        self, record: SharedRecord, message: SharedLandmarks, now_ns: int
    ) -> list[Contribution]:
        """Return the valid contributions of a message; count the others."""
        accepted, known = [], {self.robot, *record.robots}
        for sent in message.contributions:
            try:
                one = contribution_of(sent)
                check_contribution(one)
                if one.life.began_ns > now_ns + _AHEAD_NS:
                    raise ValueError("its life begins more than a day from now; check the clocks")
                if one.robot not in known and len(known) >= MOST_ROBOTS:
                    raise ValueError(f"there are contributions of {MOST_ROBOTS} robots already")
            except ValueError as error:
                self.rejected += 1
                self.reason = f"of {sent.robot!r} about object {sent.object_id}: {error}"
                continue
            known.add(one.robot)
            accepted.append(one)
        return accepted

    def compare(self, record: SharedRecord, message: SharedLandmarks, now_ns: int) -> None:
        """Prepare to send what the sender of a message may lack."""
        theirs = {one.robot: one for one in message.contributors}
        for mine in record.summaries():
            other = theirs.get(mine.robot)
            digest = 0 if other is None else other.digest
            if other is not None and digest == mine.digest:
                continue
            difference = (message.robot, mine.robot, digest, mine.digest)
            answered_ns = self._answered.get(difference)
            if answered_ns is not None and now_ns - answered_ns < _AGAIN_S * SECOND:
                continue
            if len(self._answered) >= _MOST_ANSWERED:
                self._answered.clear()
            self._answered[difference] = now_ns
            waiting = {(one.robot, one.object_id) for one in self._answers}
            self._answers.extend(
                one for one in record.of(mine.robot) if (one.robot, one.object_id) not in waiting
            )

    def take_answers(self) -> list[Contribution]:
        """Return what is to be sent next, at most as much as one message holds."""
        count = min(len(self._answers), MOST_CONTRIBUTIONS)
        return [self._answers.popleft() for _ in range(count)]

    def message(
        self,
        stamp_ns: int,
        version: int,
        landmarks: int,
        record: SharedRecord,
        contributions: Sequence[Contribution],
    ) -> SharedLandmarks:
        """Return the message with a summary of the record, and some of it."""
        return SharedLandmarks(
            header=Header(stamp=from_ns(stamp_ns), frame_id="map"),
            robot=self.robot,
            map=self.map_digest,
            map_version=version,
            landmarks=landmarks,
            rejected=self.rejected,
            contributors=tuple(map(_contributor, record.summaries())),
            contributions=tuple(map(contribution_message, contributions)),
        )


def in_messages(contributions: Iterable[Contribution]) -> list[list[Contribution]]:
    """Return contributions in parts that fit into one message each; at least one part."""
    every = list(contributions)
    starts = range(0, max(1, len(every)), MOST_CONTRIBUTIONS)
    return [every[start : start + MOST_CONTRIBUTIONS] for start in starts]


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


def _contributor(one: ContributorSummary) -> LandmarkContributor:
    return LandmarkContributor(
        robot=one.robot, newest=one.newest, count=one.count, digest=one.digest
    )
