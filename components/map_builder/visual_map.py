"""The visual map: applies each frame's evidence, and takes it back when the robot was lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from components.map_builder.objects import (
    Change,
    Evidence,
    Kind,
    MapObject,
    Place,
    State,
    judge,
    unknown,
)

JOURNAL_FRAMES = 60


@dataclass(frozen=True)
class Outcome:
    """What one frame's evidence did.

    `after` holds for each piece of evidence the object it left behind and whether it counted,
    None for an object that the map does not learn.
    """

    after: tuple[tuple[MapObject, bool] | None, ...]
    changes: tuple[Change, ...]


@dataclass(frozen=True)
class _Undo:
    frame: int
    before: MapObject


class VisualMap:
    """All objects by identifier, and the journal of the last 60 frames' losses of reliability."""

    def __init__(self, objects: Iterable[MapObject], learn_unknown: bool = True) -> None:
        self.objects: dict[int, MapObject] = {o.object_id: o for o in objects}
        self.learn_unknown = learn_unknown
        self._frame = 0
        self._journal: deque[_Undo] = deque()

    def apply(self, evidence: Sequence[Evidence]) -> Outcome:
        """Take one frame's evidence."""
        self._frame += 1
        while self._journal and self._journal[0].frame <= self._frame - JOURNAL_FRAMES:
            self._journal.popleft()
        after: list[tuple[MapObject, bool] | None] = []
        changes: list[Change] = []
        for piece in evidence:
            known = self.objects.get(piece.object_id)
            if known is None:
                if not self.learn_unknown:
                    after.append(None)
                    continue
                known = unknown(piece.object_id)
            judged, change = judge(known, piece)
            after.append((judged, judged is not known))
            if judged is known:
                continue
            if _lost_trust(known, judged):
                self._journal.append(_Undo(self._frame, known))
            self.objects[piece.object_id] = judged
            if change is not None:
                changes.append(change)
        return Outcome(tuple(after), tuple(changes))

    def take_back(self) -> tuple[list[MapObject], list[Change]]:
        """Undo the journal: the robot turned out to have been lost while it gave that evidence.

        Returns the objects as they are again and the changes of the map that this makes.
        """
        undone: dict[int, MapObject] = {}
        while self._journal:
            undo = self._journal.pop()
            undone[undo.before.object_id] = undo.before
        changes = []
        for object_id, before in undone.items():
            now = self.objects[object_id]
            self.objects[object_id] = before
            if now.state is not before.state or _apart(now.place, before.place):
                reason = "the robot was lost when it judged this object; that judgement is undone"
                changes.append(
                    Change(
                        object_id,
                        Kind.RESTORED,
                        now.place,
                        before.place if before.state is State.LIVE else None,
                        before.reliability,
                        reason,
                    )
                )
        return list(undone.values()), changes


def _apart(a: Place | None, b: Place | None) -> bool:
    return a is not b and (a is None or b is None or a.distance(b) > 0.01)


def _lost_trust(before: MapObject, after: MapObject) -> bool:
    return (
        after.reliability < before.reliability
        or after.state is not before.state
        or (after.state is State.RELOCATING and after.candidate != before.candidate)
    )
