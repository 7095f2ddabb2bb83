"""The landmarks in memory and in their file: applies evidence, numbers and commits changes."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cairn import SECOND, CairnError
from cairn.components.map_builder.landmark_rule import Rule, judge
from cairn.components.map_builder.undo import LandmarkJournal
from cairn.visual_map.evidence_history import EvidenceSummaries, Row
from cairn.visual_map.landmark_store import (
    FARTHEST_M,
    LandmarkStore,
    evidence_row,
    open_landmarks,
)
from cairn.visual_map.landmarks import (
    ChangeKind,
    EvidenceVerdict,
    LandmarkChange,
    LandmarkEvidence,
    LandmarkRecord,
    LandmarkState,
    MapPosition,
    new_landmark,
)
from cairn.visual_map.object_models import check_name, read_model_name
from cairn.visual_map.sqlite_file import MapFileError, MapNotWritable, copy_map, digest_of
from cairn.working_copy import is_reusable

_LOG = logging.getLogger("cairn.map_builder")

# Changes of so many seconds can be undone: a lost robot is found within 21 s (docs/benchmarks.md,
# navigation in simulated worlds).
UNDO_S = 60.0

# Kept in memory while the file cannot be written: half an hour of a robot that recognizes five
# objects a second, in 6 MB; and more changes than a rearranged house causes in that time.
MOST_UNSAVED_EVIDENCE = 10_000
MOST_UNSAVED_CHANGES = 1_000

MOST_LEARNED = 2_000
"""Landmarks up to which unknown objects are learned, if nothing else is given."""

NumberedChange = tuple[int, LandmarkChange]


@dataclass(frozen=True)
class AppliedEvidence:
    """What the evidence of one image changed.

    `after` holds for each piece of evidence the landmark after it and whether it counted, None for
    an object that is not in the map. `refused` are the identifiers of those that the map did not
    learn because it is full, and of those whose position would be too far for its file.
    """

    after: tuple[tuple[LandmarkRecord, bool] | None, ...]
    changes: tuple[LandmarkChange, ...]
    refused: tuple[int, ...] = ()


@dataclass(frozen=True)
class AppliedAdditions:
    """What the addition of landmarks changed; `refused` as in `AppliedEvidence`."""

    changes: tuple[LandmarkChange, ...]
    refused: tuple[int, ...] = ()


class LandmarkMap:
    """All landmarks by identifier, in memory, with a journal of the last `undo_s` seconds.

    Unknown objects are learned until there are `most_learned` landmarks. `name_of` returns the name
    of an object that is not in the map yet.
    """

    def __init__(
        self,
        landmarks: Iterable[LandmarkRecord],
        most_learned: int = MOST_LEARNED,
        rule: Rule = judge,
        undo_s: float = UNDO_S,
        name_of: Callable[[int], str | None] = lambda _: None,
    ) -> None:
        self.landmarks: dict[int, LandmarkRecord] = {one.object_id: one for one in landmarks}
        self._most_learned = most_learned
        self._rule = rule
        self._name_of = name_of
        self._journal = LandmarkJournal(undo_s)

    def apply(self, evidence: Sequence[LandmarkEvidence], now_s: float) -> AppliedEvidence:
        """Apply the evidence of one image, of `now_s` [s]."""
        self._journal.forget_old(now_s)
        after: list[tuple[LandmarkRecord, bool] | None] = []
        changes: list[LandmarkChange] = []
        refused: list[int] = []
        for piece in evidence:
            known = self.landmarks.get(piece.object_id)
            is_new = known is None
            if known is None:
                if not self._most_learned or piece.verdict is EvidenceVerdict.UNSEEN:
                    after.append(None)
                    continue
                if len(self.landmarks) >= self._most_learned:
                    refused.append(piece.object_id)
                    after.append(None)
                    continue
                known = new_landmark(piece.object_id)
            judged, change = self._rule(known, piece, now_s)
            if not _is_near(judged):
                refused.append(piece.object_id)
                after.append(None)
                continue
            if is_new and judged is known:
                after.append(None)  # evidence is kept about the map's objects only: they are few
                continue
            if is_new:
                judged = replace(judged, name=self._name_of(judged.object_id) or judged.name)
            after.append((judged, judged is not known))
            if judged is known:
                continue
            self._journal.record(now_s, known, judged)
            self.landmarks[piece.object_id] = judged
            if change is not None:
                changes.append(change)
        return AppliedEvidence(tuple(after), tuple(changes), tuple(refused))

    def add(self, landmarks: Iterable[LandmarkRecord], reason: str) -> AppliedAdditions:
        """Add landmarks with positions, except objects that the map has already."""
        added: list[LandmarkChange] = []
        refused: list[int] = []
        for one in landmarks:
            if one.object_id in self.landmarks:
                continue
            # Also where unknown objects are not learned: an operator has accepted these.
            most = self._most_learned or MOST_LEARNED
            if len(self.landmarks) >= most or not (_is_near(one) and _is_valid(one)):
                refused.append(one.object_id)
                continue
            self.landmarks[one.object_id] = one
            added.append(
                LandmarkChange(
                    one.object_id,
                    ChangeKind.REGISTERED,
                    None,
                    one.position,
                    one.reliability,
                    reason,
                )
            )
        return AppliedAdditions(tuple(added), tuple(refused))

    def undo(self, since_s: float) -> tuple[list[LandmarkRecord], list[LandmarkChange]]:
        """Undo the judgments after `since_s` [s]: the robot turned out to have been lost.

        Returns the restored landmarks and the changes of the map.
        """
        restored = self._journal.undo(since_s)
        changes = []
        for object_id, before in restored.items():
            now = self.landmarks[object_id]
            self.landmarks[object_id] = before
            if now.state is not before.state or _differ(now.position, before.position):
                reason = (
                    "the robot was lost, or may have been, when it judged this object; that "
                    "judgment is undone"
                )
                changes.append(
                    LandmarkChange(
                        object_id,
                        ChangeKind.RESTORED,
                        now.position,
                        before.position if before.state is LandmarkState.LIVE else None,
                        before.reliability,
                        reason,
                    )
                )
        return list(restored.values()), changes


class LandmarkKeeper:
    """A landmark map and its file.

    Changes are in memory until `save` commits them: save before you publish them. While the file
    cannot be written, the keeper works in memory: all landmarks, the newest `MOST_UNSAVED_CHANGES`
    changes, the newest `MOST_UNSAVED_EVIDENCE` pieces of evidence, and summaries of older ones.

    With a `working_copy`, the map itself is only read. The copy is made if it does not exist, if it
    is one of another map, or if it is of a later time (another replay); otherwise it is used again,
    as after the process that wrote it was killed.
    """

    def __init__(
        self,
        map_file: Path,
        working_copy: Path | None,
        now_ns: int,
        most_learned: int = MOST_LEARNED,
        rule: Rule = judge,
        undo_s: float = UNDO_S,
    ) -> None:
        self._original = map_file
        self.path = working_copy or map_file
        self._copies = working_copy is not None and not _is_reusable(map_file, working_copy, now_ns)
        self._store: LandmarkStore | None = None
        try:
            self._store = self._opened()
            landmarks, self.version = self._store.landmarks(), self._store.version()
        except MapNotWritable:
            with open_landmarks(map_file if self._copies else self.path, read_only=True) as store:
                landmarks, self.version = store.landmarks(), store.version()
        self._map = LandmarkMap(landmarks, most_learned, rule, undo_s, self._model_name)
        self._unsaved = _Unsaved()
        self.refused: tuple[int, ...] = ()
        """Objects whose last evidence was refused, see `AppliedEvidence`."""

    @property
    def landmarks(self) -> list[LandmarkRecord]:
        """Return all landmarks, by identifier."""
        return [self._map.landmarks[key] for key in sorted(self._map.landmarks)]

    @property
    def store(self) -> LandmarkStore | None:
        """The open file, with what was saved; None while it cannot be written."""
        return self._store

    @property
    def is_saved(self) -> bool:
        """Whether the file has everything."""
        return self._store is not None and not self._unsaved

    @property
    def unsaved(self) -> str:
        """Describe what the file does not have yet, and what was dropped since it was saved."""
        return str(self._unsaved)

    def apply(
        self, stamp_ns: int, evidence: Sequence[LandmarkEvidence]
    ) -> tuple[bool, list[NumberedChange]]:
        """Apply the evidence of one image; return whether it counted, and the changes."""
        applied = self._map.apply(evidence, stamp_ns / SECOND)
        self.refused = applied.refused
        counted = False
        for piece, after in zip(evidence, applied.after, strict=True):
            if after is not None:
                self._unsaved.add_evidence(evidence_row(stamp_ns, piece, *after))
                counted |= after[1]
        return counted, self._number(stamp_ns, applied.changes)

    def add(
        self, stamp_ns: int, landmarks: Iterable[LandmarkRecord], reason: str
    ) -> list[NumberedChange]:
        """Add landmarks that the map does not have yet, at `stamp_ns`; return the changes."""
        applied = self._map.add(landmarks, reason)
        self.refused = applied.refused
        self._unsaved.landmarks |= bool(applied.changes)
        return self._number(stamp_ns, applied.changes)

    def undo(self, stamp_ns: int, since_ns: int) -> tuple[bool, list[NumberedChange]]:
        """Undo at `stamp_ns` what was judged after `since_ns`, because the robot was lost."""
        restored, changes = self._map.undo(since_ns / SECOND)
        self._unsaved.landmarks |= bool(restored)
        return bool(restored), self._number(stamp_ns, changes)

    def save(self) -> None:
        """Commit everything that the file does not have yet; raises `MapFileError`."""
        if self.is_saved:
            return
        if self._store is None:
            self._store = self._opened()
        unsaved = self._unsaved
        self._store.commit(self.landmarks, unsaved.evidence, unsaved.changes, unsaved.summaries)
        self._unsaved = _Unsaved()

    def close(self) -> None:
        """Close the file without committing; the next keeper continues with what was saved."""
        if self._store is not None:
            self._store.close()

    def _opened(self) -> LandmarkStore:
        if self._copies:
            copy_map(self._original, self.path)
            self._copies = False
        return open_landmarks(self.path)

    def _model_name(self, object_id: int) -> str | None:
        """Return the name of an object, which may have been taught after the copy was made."""
        try:
            return read_model_name(self._original, object_id)
        except MapFileError:
            return None  # the recognizer reports the file; a landmark may do without its name

    def _number(self, stamp_ns: int, changes: Sequence[LandmarkChange]) -> list[NumberedChange]:
        numbered = [(self.version + k, change) for k, change in enumerate(changes, start=1)]
        for version, change in numbered:
            self._unsaved.add_change((version, stamp_ns, change))
        self.version += len(changes)
        return numbered


class _Unsaved:
    """What the file of a map does not have yet, within bounds."""

    def __init__(self) -> None:
        self.evidence: deque[Row] = deque()
        self.summaries = EvidenceSummaries()
        self.changes: deque[tuple[int, int, LandmarkChange]] = deque()
        self.landmarks = False  # changed without evidence: undone, or added
        self._summarized = 0
        self._dropped = 0

    def __bool__(self) -> bool:
        return bool(self.evidence or self.changes or self.landmarks)

    def __str__(self) -> str:
        lost = f"{len(self.changes)} changes and {len(self.evidence)} pieces of evidence are lost"
        notes = []
        if self._summarized:
            notes.append(f"{self._summarized} older pieces of evidence are only counted")
        if self._dropped:
            notes.append(f"{self._dropped} older changes are already missing from the history")
        return f"{lost} ({'; '.join(notes)})" if notes else lost

    def add_evidence(self, row: Row) -> None:
        if len(self.evidence) >= MOST_UNSAVED_EVIDENCE:
            self.summaries.add_row(self.evidence.popleft())
            self._summarized += 1
        self.evidence.append(row)

    def add_change(self, change: tuple[int, int, LandmarkChange]) -> None:
        if len(self.changes) >= MOST_UNSAVED_CHANGES:
            self.changes.popleft()
            self._dropped += 1
        self.changes.append(change)


def _is_reusable(map_file: Path, working_copy: Path, now_ns: int) -> bool:
    if not working_copy.exists():
        return False
    with open_landmarks(working_copy, read_only=True) as previous:
        same = previous.digest() == digest_of(map_file)
        ahead = previous.last_stamp_ns() > now_ns
    return is_reusable(working_copy, _LOG, same=same, ahead=ahead)


def _is_near(landmark: LandmarkRecord) -> bool:
    """Return whether the file of a map takes the positions of a landmark, and their covariances."""
    found = landmark.candidate
    positions = (landmark.position, found.position if found else None)
    return all(
        abs(value) <= FARTHEST_M
        for one in positions
        if one is not None
        for value in (one.x, one.y, one.xx, one.xy, one.yy)
    )


def _is_valid(landmark: LandmarkRecord) -> bool:
    """Return whether the file of a map takes the name and the covariance of a landmark."""
    at = landmark.position
    if at is None or min(at.xx, at.yy) < 0.0 or at.xy**2 > at.xx * at.yy:
        return False
    try:
        check_name(landmark.name)
    except CairnError:
        return False
    return True


# A smaller difference of positions [m] is not a change that readers of the map need.
_SAME_M = 0.01


def _differ(a: MapPosition | None, b: MapPosition | None) -> bool:
    return a is not b and (a is None or b is None or a.distance(b) > _SAME_M)
