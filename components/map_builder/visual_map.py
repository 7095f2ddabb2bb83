"""The visual map: applies each frame's evidence, and takes it back when the robot was lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from cairn.components.map_builder.objects import (
    Change,
    Evidence,
    Kind,
    MapObject,
    State,
    Verdict,
    unknown,
)
from cairn.components.map_builder.place import Place
from cairn.components.map_builder.rule import Rule, judge

UNDO_S = 60.0


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
    at_s: float
    before: MapObject


class VisualMap:
    """All objects by identifier, and the journal of the last `undo_s` seconds' losses of trust.

    `name_of` tells what an object is called that the map does not hold yet.
    """

    def __init__(
        self,
        objects: Iterable[MapObject],
        learn_unknown: bool = True,
        rule: Rule = judge,
        undo_s: float = UNDO_S,
        name_of: Callable[[int], str | None] = lambda _: None,
    ) -> None:
        self.objects: dict[int, MapObject] = {o.object_id: o for o in objects}
        self.learn_unknown = learn_unknown
        self._rule = rule
        self._undo_s = undo_s
        self._name_of = name_of
        self._journal: deque[_Undo] = deque()

    def apply(self, evidence: Sequence[Evidence], now_s: float) -> Outcome:
        """Take one frame's evidence, of `now_s` [s]."""
        while self._journal and self._journal[0].at_s < now_s - self._undo_s:
            self._journal.popleft()
        after: list[tuple[MapObject, bool] | None] = []
        changes: list[Change] = []
        for piece in evidence:
            known = self.objects.get(piece.object_id)
            if known is None:
                if not self.learn_unknown or piece.verdict is Verdict.UNSEEN:
                    after.append(None)
                    continue
                known = unknown(piece.object_id, self._name_of(piece.object_id))
            judged, change = self._rule(known, piece, now_s)
            after.append((judged, judged is not known))
            if judged is known:
                continue
            if _lost_trust(known, judged):
                self._journal.append(_Undo(now_s, known))
            self.objects[piece.object_id] = judged
            if change is not None:
                changes.append(change)
        return Outcome(tuple(after), tuple(changes))

    def take_back(self, since_s: float) -> tuple[list[MapObject], list[Change]]:
        """Undo the journal since `since_s` [s]: the robot turned out to have been lost after that.

        Returns the objects as they are again and the changes of the map that this makes.
        """
        undone: dict[int, MapObject] = {}
        while self._journal and self._journal[-1].at_s > since_s:
            undo = self._journal.pop()
            undone[undo.before.object_id] = undo.before
        changes = []
        for object_id, before in undone.items():
            now = self.objects[object_id]
            self.objects[object_id] = before
            if now.state is not before.state or _apart(now.place, before.place):
                reason = (
                    "the robot was lost, or may have been, when it judged this object; that "
                    "judgment is undone"
                )
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
