"""The landmarks in memory and in their file: applies evidence, numbers and commits changes."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cairn import SECOND, CairnError
from cairn.components.map_builder.landmark_sharing import LandmarkSharing, SharedLandmark
from cairn.components.map_builder.landmark_verdicts import Rule, judge
from cairn.components.map_builder.undo import LandmarkJournal
from cairn.system.working_copy import is_reusable, set_aside
from cairn.visual_map.evidence_history import EvidenceSummaries, Row
from cairn.visual_map.landmark_store import (
    LandmarkStore,
    evidence_row,
    open_landmarks,
)
from cairn.visual_map.landmarks import (
    FARTHEST_M,
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
from cairn.visual_map.shared_record import Contribution
from cairn.visual_map.sqlite_file import (
    DamagedMap,
    MapFileError,
    MapNotWritable,
    copy_map,
    digest_of,
)

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
            after.append(None)  # unless it is kept
            known = self.landmarks.get(piece.object_id)
            is_new = known is None
            if known is None:
                if not self._most_learned or piece.verdict is EvidenceVerdict.UNSEEN:
                    continue
                if len(self.landmarks) >= self._most_learned:
                    refused.append(piece.object_id)
                    continue
                known = new_landmark(piece.object_id)
            judged, change = self._rule(known, piece, now_s)
            if not _is_near(judged):
                refused.append(piece.object_id)
                continue
            if is_new and judged is known:
                continue  # evidence is kept about the map's objects only: they are few
            if is_new:
                judged = replace(judged, name=self._name_of(judged.object_id) or judged.name)
            after[-1] = (judged, judged is not known)
            if judged is known:
                continue
            self._journal.record(now_s, known, judged)
            self.landmarks[piece.object_id] = judged
            if change is not None:
                changes.append(change)
        return AppliedEvidence(tuple(after), tuple(changes), tuple(refused))

    def add(self, landmarks: Iterable[LandmarkRecord], reason: str) -> AppliedEvidence:
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
        return AppliedEvidence((), tuple(added), tuple(refused))

    def replace(self, landmark: LandmarkRecord, change: LandmarkChange | None) -> None:
        """Replace a landmark by what other robots know; after a `change` nothing of it is undone.

        Otherwise, the robot would undo what others have found out since.
        """
        self.landmarks[landmark.object_id] = landmark
        if change is not None:
            self._journal.forget(landmark.object_id)

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

    With `robot`, the landmarks are shared under this name with robots that have the same map:
    `merge` takes what they contribute, `take_contributions` returns what is to be sent to them.
    This requires a working copy, as the map itself identifies what is shared.

    With a `working_copy`, the map itself is only read. The copy is made if it does not exist, if it
    is one of another map, or if it is of a later time than `now_ns`: of another replay. Otherwise
    it is used again, as after the process that wrote it was killed. `now_ns` is None on a system
    clock, which may have been set back: nothing learned is discarded for that.
    """

    def __init__(
        self,
        map_file: Path,
        working_copy: Path | None,
        now_ns: int | None,
        most_learned: int = MOST_LEARNED,
        rule: Rule = judge,
        undo_s: float = UNDO_S,
        robot: str | None = None,
    ) -> None:
        self._original = map_file
        self.path = working_copy or map_file
        self._copies = working_copy is not None and not _is_reusable(map_file, working_copy, now_ns)
        self.store: LandmarkStore | None = None
        """The open file, with what was saved; None while it cannot be written."""
        try:
            self.store = self._opened()
            opened = _Opened.of(self.store)
        except MapNotWritable:
            with open_landmarks(map_file if self._copies else self.path, read_only=True) as store:
                opened = _Opened.of(store)
        self.version = opened.version
        self._map = LandmarkMap(opened.landmarks, most_learned, rule, undo_s, self._model_name)
        self._most_landmarks = most_learned or MOST_LEARNED
        self._unsaved = _Unsaved()
        self.refused: tuple[int, ...] = ()
        """Objects whose last evidence was refused, see `AppliedEvidence`."""
        self.sharing: LandmarkSharing | None = None
        self._to_send: dict[int, Contribution] = {}
        self._unshared: frozenset[int] = frozenset()
        if robot is not None:
            self.sharing = self._share(robot, opened)

    @property
    def landmarks(self) -> list[LandmarkRecord]:
        """Return all landmarks, by identifier."""
        return [self._map.landmarks[key] for key in sorted(self._map.landmarks)]

    @property
    def is_saved(self) -> bool:
        """Whether the file has everything."""
        return self.store is not None and not self._unsaved

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
        touched = {
            one.object_id for one, after in zip(evidence, applied.after, strict=True) if after
        }
        self._contribute(stamp_ns, touched, applied.changes)
        return counted, self._number(stamp_ns, applied.changes)

    def add(
        self, stamp_ns: int, landmarks: Iterable[LandmarkRecord], reason: str
    ) -> list[NumberedChange]:
        """Add landmarks that the map does not have yet, at `stamp_ns`; return the changes."""
        applied = self._map.add(landmarks, reason)
        self.refused = applied.refused
        self._unsaved.landmarks |= bool(applied.changes)
        # Other robots have no model of an accepted object, and may use its number for another one.
        self._unshared |= {one.object_id for one in applied.changes}
        return self._number(stamp_ns, applied.changes)

    def merge(
        self, stamp_ns: int, contributions: Iterable[Contribution]
    ) -> tuple[bool, list[NumberedChange]]:
        """Take in contributions of robots at `stamp_ns`; return whether they matter, and changes.

        They must have passed `check_contribution`. `refused` are the objects that the map does not
        take because it is full.
        """
        assert self.sharing is not None
        sharing, refused, accepted = self.sharing, set[int](), list[Contribution]()
        room = self._most_landmarks - len(self._map.landmarks.keys() | set(sharing.record.objects))
        new = set[int]()
        for one in contributions:
            known = one.object_id in self._map.landmarks or one.object_id in sharing.record
            if not known and one.object_id not in new and len(new) >= room:
                refused.add(one.object_id)
                continue
            if not known:
                new.add(one.object_id)
            accepted.append(one)
        before = {one.object_id: sharing.landmark(one.object_id) for one in accepted}
        changed = sorted(sharing.record.merge(accepted))
        self.refused = tuple(sorted(refused))
        self._unsaved.contributions |= set(changed)
        changes = []
        for object_id in changed:
            change = self._adopt(object_id, before[object_id], stamp_ns)
            if change is not None:
                changes.append(change)
        return bool(changed), self._number(stamp_ns, changes)

    def take_contributions(self) -> list[Contribution]:
        """Return the robot's own contributions since the last call, at most one about an object."""
        taken, self._to_send = self._to_send, {}
        return list(taken.values())

    def undo(self, stamp_ns: int, since_ns: int) -> tuple[bool, list[NumberedChange]]:
        """Undo at `stamp_ns` what was judged after `since_ns`, because the robot was lost."""
        restored, changes = self._map.undo(since_ns / SECOND)
        self._unsaved.landmarks |= bool(restored)
        self._contribute(stamp_ns, {one.object_id for one in restored}, changes)
        return bool(restored), self._number(stamp_ns, changes)

    def save(self) -> None:
        """Commit everything that the file does not have yet; raises `MapFileError`."""
        if self.is_saved:
            return
        if self.store is None:
            self.store = self._opened()
        unsaved = self._unsaved
        shared: dict[int, list[Contribution]] = {}
        if self.sharing is not None:
            record = self.sharing.record
            shared = {object_id: record.about(object_id) for object_id in unsaved.contributions}
        self.store.commit(
            self.landmarks, unsaved.evidence, unsaved.changes, unsaved.summaries, shared
        )
        self._unsaved = _Unsaved()

    def close(self) -> None:
        """Close the file without committing; the next keeper continues with what was saved."""
        if self.store is not None:
            self.store.close()

    def _share(self, robot: str, opened: _Opened) -> LandmarkSharing:
        """Return the robot's part in the shared record, which has what its map has.

        Landmarks of the map that this robot has changed while it did not share become its
        contributions; those that it has learned or accepted meanwhile stay its own.
        """
        if self.path == self._original:
            raise CairnError(
                f"{self._original} cannot be shared without a working copy: the map from which all "
                "robots start must stay as it is; set the parameter working_copy"
            )
        with open_landmarks(self._original, read_only=True) as store:
            originals = {one.object_id: one for one in store.landmarks()}
        sharing = LandmarkSharing(robot, originals.values(), opened.contributions)
        unshared = set()
        for object_id, landmark in self._map.landmarks.items():
            original = originals.get(object_id)
            if object_id in sharing.record:
                continue
            if original is None and landmark.position is not None:
                unshared.add(object_id)
            elif original is None:
                continue  # a candidate, which is shared once it is registered
            elif landmark.state is not original.state or landmark.position != original.position:
                registered = landmark.state is LandmarkState.LIVE
                if sharing.contribute(landmark, opened.last_stamp_ns, registered=registered):
                    self._unsaved.contributions.add(object_id)
        self._unshared = frozenset(unshared)
        return sharing

    def _contribute(
        self, stamp_ns: int, touched: Iterable[int], changes: Iterable[LandmarkChange]
    ) -> None:
        """Add what the robot has found out itself to the shared record."""
        if self.sharing is None:
            return
        began = (ChangeKind.REGISTERED, ChangeKind.RESTORED)
        registered = {one.object_id for one in changes if one.kind in began}
        for object_id in sorted(set(touched) - self._unshared):
            landmark = self._map.landmarks[object_id]
            one = self.sharing.contribute(landmark, stamp_ns, registered=object_id in registered)
            if one is not None:
                self._to_send[object_id] = one
                self._unsaved.contributions.add(object_id)
                # The same up to rounding: as the other robots compute it.
                self._adopt(object_id, self.sharing.landmark(object_id), stamp_ns)

    def _adopt(
        self, object_id: int, before: SharedLandmark | None, stamp_ns: int
    ) -> LandmarkChange | None:
        """Have a landmark in the map as the shared record knows it; return the change, if any."""
        assert self.sharing is not None
        if object_id in self._unshared:
            return None
        landmark = self._map.landmarks.get(object_id)
        adopted = self.sharing.adopted(landmark, object_id, before, stamp_ns / SECOND)
        if adopted is None:
            return None
        after, change = adopted
        if landmark is None:
            after = replace(after, name=self._model_name(object_id) or after.name)
        self._map.replace(after, change)
        return change

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


@dataclass(frozen=True)
class _Opened:
    """The content of a map file."""

    landmarks: list[LandmarkRecord]
    version: int
    contributions: list[Contribution]
    last_stamp_ns: int

    @classmethod
    def of(cls, store: LandmarkStore) -> _Opened:
        """Read an open file."""
        return cls(store.landmarks(), store.version(), store.contributions(), store.last_stamp_ns())


class _Unsaved:
    """What the file of a map does not have yet, within bounds."""

    def __init__(self) -> None:
        self.evidence: deque[Row] = deque()
        self.summaries = EvidenceSummaries()
        self.changes: deque[tuple[int, int, LandmarkChange]] = deque()
        self.landmarks = False  # changed without evidence: undone, or added
        self.contributions: set[int] = set()  # objects of which the shared record has changed
        self._summarized = 0
        self._dropped = 0

    def __bool__(self) -> bool:
        return bool(self.evidence or self.changes or self.landmarks or self.contributions)

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


def _is_reusable(map_file: Path, working_copy: Path, now_ns: int | None) -> bool:
    if not working_copy.exists():
        return False
    original = digest_of(map_file)
    try:
        with open_landmarks(working_copy, read_only=True) as previous:
            last_ns = _Opened.of(previous).last_stamp_ns
            same = previous.digest() == original
    except DamagedMap as error:
        set_aside(working_copy, _LOG, error)
        return False
    ahead = now_ns is not None and last_ns > now_ns
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
