"""Exchanges a shared record with other robots: what to send, what to accept.

Each robot repeats a short summary of its record once a second. A robot that notices a difference
sends what the other may lack, so loss, duplication and reordering of messages, and days without
contact, only delay.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from random import Random
from typing import Final, Generic, Protocol, TypeVar

from cairn import SECOND
from cairn.schemas.cairn_msgs import RecordContributor
from cairn.visual_map.shared_record import MOST_ROBOTS, ContributorSummary

# A difference is answered again after this time [s]: the other has then had the time to receive the
# answer, and what it does not accept is not sent every second.
_AGAIN_S: Final = 5.0
# Answers are kept for so many differences, of all robots with all others.
_MOST_ANSWERED: Final = 4096
MOST_AHEAD_NS: Final = 24 * 3600 * SECOND
"""What a robot states of a later time than this after now [ns] is of a wrong clock: it could not be
replaced by robots whose clocks are right, unless they know it."""


class Piece(Protocol):
    """A piece of a shared record, which one robot has contributed."""

    @property
    def robot(self) -> str:
        """The name of the robot."""

    @property
    def subject(self) -> Hashable:
        """What distinguishes it from the other pieces of its robot."""

    @property
    def version(self) -> int:
        """A number that is not smaller than those of earlier pieces of its robot."""


PieceT = TypeVar("PieceT", bound=Piece)
SentT = TypeVar("SentT")


class Record(Protocol[PieceT]):
    """What robots have contributed."""

    @property
    def robots(self) -> list[str]:
        """The robots that have contributed."""

    def of(self, robot: str) -> list[PieceT]:
        """Return the pieces of a robot."""

    def summaries(self) -> list[ContributorSummary]:
        """Return the summary of each robot's pieces, by robot."""


class Exchange(Generic[SentT, PieceT]):
    """What a robot sends of a record, and accepts for it.

    `read` returns the piece in a part of a message that was received at a time [ns]; it raises
    `ValueError` with the reason why no robot contributes that.
    """

    def __init__(
        self, robot: str, map_digest: str, most: int, read: Callable[[SentT, int], PieceT]
    ) -> None:
        self.robot = robot
        self.map_digest = map_digest
        self.rejected = 0
        """Pieces that were not accepted."""
        self.reason = ""
        """Why the last one was not."""
        self._most = most
        self._read = read
        # The order of answers is random, so that robots with the same record send different parts.
        self._random = Random(robot)
        self._answers: dict[tuple[str, Hashable], PieceT] = {}
        self._answered: dict[tuple[str, str, int, int], int] = {}

    def accept(self, record: Record[PieceT], sent: Iterable[SentT], now_ns: int) -> list[PieceT]:
        """Return the valid pieces of a message; count the others."""
        accepted, known = [], {self.robot, *record.robots}
        for part in sent:
            try:
                one = self._read(part, now_ns)
                if one.robot not in known and len(known) >= MOST_ROBOTS:
                    raise ValueError(
                        f"of {one.robot!r}: there are contributions of {MOST_ROBOTS} robots already"
                    )
            except ValueError as error:
                self.rejected += 1
                self.reason = str(error)
                continue
            known.add(one.robot)
            accepted.append(one)
        return accepted

    def compare(
        self,
        record: Record[PieceT],
        sender: str,
        contributors: Iterable[RecordContributor],
        sent: Sequence[PieceT],
        now_ns: int,
    ) -> None:
        """Prepare to send what the sender of a message may lack, except what others have `sent`."""
        for one in sent:
            waiting = self._answers.get((one.robot, one.subject))
            if waiting is not None and waiting.version <= one.version:
                del self._answers[one.robot, one.subject]
        theirs = {one.robot: one for one in contributors}
        for mine in record.summaries():
            other = theirs.get(mine.robot)
            digest = 0 if other is None else other.digest
            if other is not None and digest == mine.digest:
                continue
            difference = (sender, mine.robot, digest, mine.digest)
            answered_ns = self._answered.get(difference)
            if answered_ns is not None and now_ns - answered_ns < _AGAIN_S * SECOND:
                continue
            if len(self._answered) >= _MOST_ANSWERED:
                self._answered.clear()
            self._answered[difference] = now_ns
            # Usually the other lacks only what is newer; what it may lack before that comes next.
            newest = 0 if other is None or other.newest >= mine.newest else other.newest
            lacking = [one for one in record.of(mine.robot) if one.version >= newest]
            self._random.shuffle(lacking)
            for one in lacking:
                self._answers[one.robot, one.subject] = one

    def take_answers(self, most: int | None = None) -> list[PieceT]:
        """Return what is to be sent next, at most `most` and as much as one message holds."""
        room = self._most if most is None else min(most, self._most)
        return [self._answers.pop(key) for key in list(self._answers)[:room]]

    def in_messages(self, pieces: Iterable[PieceT]) -> list[list[PieceT]]:
        """Return pieces in parts that fit into one message each; at least one part."""
        every = list(pieces)
        starts = range(0, max(1, len(every)), self._most)
        return [every[start : start + self._most] for start in starts]


def contributor_messages(record: Record[PieceT]) -> tuple[RecordContributor, ...]:
    """Return the summary of a record for other robots."""
    return tuple(
        RecordContributor(robot=one.robot, newest=one.newest, count=one.count, digest=one.digest)
        for one in record.summaries()
    )
