"""The transforms of one frame to its parent over time, sorted by their stamps."""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from typing import cast

from cairn.tf import rigid_motion
from cairn.tf.rigid_motion import Motion

_NUMBERS = 7  # of a motion


class FrameHistory:
    """A frame and its transforms; a frame without transforms is the root of a tree.

    The numbers are in arrays, 68 bytes for each transform, and not in objects.

    Attributes:
        name: name of the frame.
        number: its number in the buffer, by which transforms refer to their parents.
        is_static: whether the one transform holds at all times.
        publisher: what published the newest transform; empty if that is unknown.
        stamps: times of the transforms [ns], ascending.
    """

    __slots__ = ("_motions", "_parents", "is_static", "name", "number", "publisher", "stamps")

    def __init__(self, name: str, number: int) -> None:
        self.name = name
        self.number = number
        self.is_static = False
        self.publisher = ""
        self.stamps = array("q")
        self._motions = array("d")
        self._parents = array("i")

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def newest_parent(self) -> int | None:
        """Number of the parent of the newest transform; None for a root."""
        return self._parents[-1] if self._parents else None

    def set_static(self, stamp: int, parent: int, motion: Motion) -> None:
        """Replace all transforms by one that holds at all times."""
        self.clear()
        self.is_static = True
        self.insert(stamp, parent, motion)

    def insert(self, stamp: int, parent: int, motion: Motion) -> None:
        """Add a transform at its place in time; replace one of the same stamp."""
        at = len(self.stamps)
        if at and stamp <= self.stamps[-1]:
            at = bisect_left(self.stamps, stamp)
            if self.stamps[at] == stamp:
                self._motions[_NUMBERS * at : _NUMBERS * (at + 1)] = array("d", motion)
                self._parents[at] = parent
                return
        self.stamps.insert(at, stamp)
        self._parents.insert(at, parent)
        self._motions[_NUMBERS * at : _NUMBERS * at] = array("d", motion)

    def drop_before(self, stamp: int) -> None:
        """Drop the transforms that are older than a time [ns]."""
        if self.stamps and self.stamps[0] < stamp:
            self.drop_oldest(bisect_left(self.stamps, stamp))

    def drop_oldest(self, count: int) -> None:
        """Drop so many of the oldest transforms."""
        del self.stamps[:count]
        del self._parents[:count]
        del self._motions[: _NUMBERS * count]

    def clear(self) -> None:
        """Drop all transforms."""
        self.is_static = False
        self.drop_oldest(len(self.stamps))

    def place(self, time_ns: int | None) -> int | None:
        """Return the index of the transform at a time [ns], or of the last one before it.

        None stands for the newest time. Returns None if no transform holds at that time.
        """
        if self.is_static:
            return 0
        stamps = self.stamps
        if not stamps:
            return None
        last = len(stamps) - 1
        if time_ns is None or time_ns == stamps[last]:
            return last
        index = bisect_right(stamps, time_ns) - 1
        return index if 0 <= index < last else None

    def parent_at(self, index: int) -> int:
        """Return the number of the parent in a transform."""
        return self._parents[index]

    def motion_at(self, index: int, time_ns: int | None) -> Motion:
        """Return parent <- frame at a time [ns] from transform `index` on, as `place` found it.

        It is interpolated, unless the parent changes in between: then the older transform holds.
        """
        motion = cast("Motion", tuple(self._motions[_NUMBERS * index : _NUMBERS * (index + 1)]))
        if time_ns is None or self.is_static:
            return motion
        before = self.stamps[index]
        if before == time_ns or self._parents[index] != self._parents[index + 1]:
            return motion
        later = tuple(self._motions[_NUMBERS * (index + 1) : _NUMBERS * (index + 2)])
        fraction = (time_ns - before) / (self.stamps[index + 1] - before)
        return rigid_motion.interpolate(motion, cast("Motion", later), fraction)
