"""Keeps a visual map and its file in step: evidence in, changes out, nothing lost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cairn import SECOND
from cairn.components.map_builder.objects import Change, Evidence, MapObject
from cairn.components.map_builder.rule import Rule, judge
from cairn.components.map_builder.store import Judged, MapStore, open_map
from cairn.components.map_builder.visual_map import UNDO_S, VisualMap
from cairn.components.map_builder.working_copy import gone_on_with
from cairn.visual_map.file import MapFileError, copy_map, digest_of
from cairn.visual_map.object_models import read_model_name

NumberedChange = tuple[int, Change]


class MapKeeper:
    """A visual map on disk.

    Changes are committed before they are returned; evidence is gathered until `save`. With a
    `working_copy`, the map itself is only read: the copy is made of it when there is none, when
    the copy is one of another map, or when its time lies ahead (another replay), and is gone on
    with otherwise, as after the death of the process that wrote it.
    """

    def __init__(
        self,
        map_file: Path,
        working_copy: Path | None,
        now_ns: int,
        learn_unknown: bool,
        rule: Rule = judge,
        undo_s: float = UNDO_S,
    ) -> None:
        self._taught = map_file
        self.path = _working_file(map_file, working_copy, now_ns)
        self._store: MapStore = open_map(self.path)
        self._map = VisualMap(self._store.objects(), learn_unknown, rule, undo_s, self._taught_name)
        self.version = self._store.version()
        self._pending: list[Judged] = []

    @property
    def objects(self) -> list[MapObject]:
        """All objects, by identifier."""
        return [self._map.objects[key] for key in sorted(self._map.objects)]

    def apply(
        self, stamp_ns: int, evidence: Sequence[Evidence]
    ) -> tuple[bool, list[NumberedChange]]:
        """Take one frame's evidence: whether any object is not as before, and the changes."""
        outcome = self._map.apply(evidence, stamp_ns / SECOND)
        touched = False
        for piece, after in zip(evidence, outcome.after, strict=True):
            if after is not None:
                self._pending.append(Judged(stamp_ns, piece, *after))
                touched |= after[1]
        return touched, self._commit(stamp_ns, outcome.changes)

    def take_back(self, stamp_ns: int, since_ns: int) -> tuple[bool, list[NumberedChange]]:
        """At `stamp_ns`, undo what the robot has judged since `since_ns`: it was lost."""
        undone, changes = self._map.take_back(since_ns / SECOND)
        if not undone:
            return False, []
        numbered = self._commit(stamp_ns, changes)
        self.save()
        return True, numbered

    def _taught_name(self, object_id: int) -> str | None:
        """The name of an object, which may have been taught since the working copy was made."""
        try:
            return read_model_name(self._taught, object_id)
        except MapFileError:
            return None  # the recognizer tells of the file, and a map without the name is a map

    def save(self) -> None:
        """Commit the evidence gathered so far."""
        self._store.commit(self.objects, self._pending)
        self._pending.clear()

    def save_pending(self) -> None:
        """Commit the evidence gathered so far, if there is any."""
        if self._pending:
            self.save()

    def close(self) -> None:
        """Commit what is left and close the file."""
        try:
            self.save_pending()
        finally:
            self._store.close()

    def abandon(self) -> None:
        """Close the file without the evidence that is not committed yet."""
        self._store.close()

    def _commit(self, stamp_ns: int, changes: Sequence[Change]) -> list[NumberedChange]:
        if not changes:
            return []
        numbered = [(self.version + k, change) for k, change in enumerate(changes, start=1)]
        self._store.commit(
            self.objects,
            self._pending,
            [(version, stamp_ns, change) for version, change in numbered],
        )
        self._pending.clear()
        self.version += len(changes)
        return numbered


def _working_file(map_file: Path, working_copy: Path | None, now_ns: int) -> Path:
    if working_copy is None:
        return map_file
    if working_copy.exists():
        with open_map(working_copy, read_only=True) as left:
            same = left.digest() == digest_of(map_file)
            ahead = left.last_stamp_ns() > now_ns
        if gone_on_with(working_copy, same=same, ahead=ahead):
            return working_copy
    copy_map(map_file, working_copy)
    return working_copy
