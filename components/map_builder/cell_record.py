"""The record that robots with the same grid map share: the latest decision about each cell.

A robot **decides** that a cell is free, occupied or unknown when its own scans have changed the
cell in its map. Of each cell the latest decision counts, by time, then by the robot's name, then by
what was decided. That is the maximum of a total order for each cell, so merging is commutative,
associative and idempotent: records that have received the same decisions are equal, whatever the
order, the repetitions and the detours. Nothing here depends on a bus or a clock;
docs/concepts/sharing.md has the reasons.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN
from cairn.visual_map.shared_record import (
    MOST_STAMP_NS,
    ContributorSummary,
    check_robot_name,
)

TILE: Final = 16
"""Cells on each side of a tile."""

_BYTES: Final = TILE * TILE // 8
_MOST_DIGEST: Final = 2**64


class Tiles:
    """The tiles of a map of `shape` (rows, columns), numbered row by row from its origin.

    Those at the end of a row or column of tiles may have fewer cells.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._rows, self._columns = shape
        self._in_row = -(-self._columns // TILE)
        self.count = self._in_row * -(-self._rows // TILE)

    def window(self, tile: int) -> tuple[slice, slice]:
        """Return the rows and columns of the map that a tile covers."""
        row, column = divmod(tile, self._in_row)
        top, left = row * TILE, column * TILE
        bottom, right = min(top + TILE, self._rows), min(left + TILE, self._columns)
        return slice(top, bottom), slice(left, right)

    def at(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> list[int]:
        """Return the tiles in which cells of the map are."""
        return [int(one) for one in np.unique(rows // TILE * self._in_row + columns // TILE)]

    def cells(self, tile: int) -> int:
        """Return the set of the cells of a tile that are on the map."""
        rows, columns = self.window(tile)
        return set_of(np.ones((rows.stop - rows.start, columns.stop - columns.start), np.bool_))


def set_of(cells: NDArray[np.bool_]) -> int:
    """Return cells (rows, columns) of a tile as a set: bit TILE * row + column is one cell."""
    whole = np.zeros((TILE, TILE), np.bool_)
    whole[: cells.shape[0], : cells.shape[1]] = cells
    return int.from_bytes(np.packbits(whole, bitorder="little").tobytes(), "little")


def cells_in(members: int) -> NDArray[np.bool_]:
    """Return a set of a tile's cells as an array (TILE, TILE)."""
    packed = np.frombuffer(members.to_bytes(_BYTES, "little"), np.uint8)
    return np.unpackbits(packed, bitorder="little").reshape(TILE, TILE).view(np.bool_)


def to_bytes(members: int) -> NDArray[np.uint8]:
    """Return a set of a tile's cells as bytes, the lowest first."""
    return np.frombuffer(members.to_bytes(_BYTES, "little"), np.uint8)


def from_bytes(packed: NDArray[np.uint8]) -> int:
    """Return the set in bytes that `to_bytes` has made."""
    return int.from_bytes(packed.tobytes(), "little")


@dataclass(frozen=True)
class Decision:
    """What `robot` has decided at one time about some cells of a tile, as sets of cells.

    Attributes:
        stamp_ns: time by the robot's clock, but later than that of any decision about these cells
            that it knew, and of any of its own (a hybrid logical clock, Kulkarni 2014) [ns].
    """

    robot: str
    tile: int
    stamp_ns: int
    free: int = 0
    occupied: int = 0
    unknown: int = 0

    @property
    def cells(self) -> int:
        """Return the set of cells that it is about."""
        return self.free | self.occupied | self.unknown

    @property
    def subject(self) -> tuple[int, int]:
        """Return what distinguishes it from all other decisions of its robot."""
        return self.tile, self.stamp_ns

    @property
    def version(self) -> int:
        """Return a number that is greater than those of all earlier decisions of its robot."""
        return self.stamp_ns

    @property
    def rank(self) -> tuple[int, str]:
        """Return its rank among the decisions about a cell."""
        return self.stamp_ns, self.robot

    def without(self, cells: int) -> Decision:
        """Return what it has decided about other cells."""
        if not self.cells & cells:
            return self
        free, occupied, unknown = self.free & ~cells, self.occupied & ~cells, self.unknown & ~cells
        return replace(self, free=free, occupied=occupied, unknown=unknown)

    def joined(self, other: Decision) -> Decision:
        """Return both, of one rank and tile; occupied outranks unknown, which outranks free.

        Two different decisions of one rank are of two robots that have one name by mistake.
        """
        occupied = self.occupied | other.occupied
        unknown = (self.unknown | other.unknown) & ~occupied
        free = (self.free | other.free) & ~occupied & ~unknown
        return replace(self, free=free, occupied=occupied, unknown=unknown)

    def values(self) -> Iterator[tuple[int, int]]:
        """Yield the sets of cells with the value of each in a grid map."""
        yield self.free, FREE
        yield self.occupied, OCCUPIED
        yield self.unknown, UNKNOWN


def check_decision(one: Decision, tiles: Tiles) -> None:
    """Raise `ValueError` with the value that no robot decides."""
    check_robot_name(one.robot)
    if not 0 <= one.tile < tiles.count:
        raise ValueError(f"the map has no tile {one.tile}: it has {tiles.count}")
    if not 1 <= one.stamp_ns <= MOST_STAMP_NS:
        raise ValueError(f"its time {one.stamp_ns} is not from 1 to {MOST_STAMP_NS:g}")
    if not one.cells:
        raise ValueError("it is about no cell")
    if one.free & one.occupied or (one.free | one.occupied) & one.unknown:
        raise ValueError("it has a cell in two states")
    if one.cells & ~tiles.cells(one.tile):
        raise ValueError("it is about cells outside the map")


class CellRecord:
    """The latest decision about each cell of one map, of all robots."""

    def __init__(self, decisions: Iterable[Decision] = ()) -> None:
        self._tiles: dict[int, dict[tuple[int, str], Decision]] = {}
        self._of: dict[str, dict[tuple[int, int], Decision]] = {}
        self._digests: dict[str, int] = {}
        self._summaries: dict[str, ContributorSummary] = {}
        self.merge(decisions)

    def __iter__(self) -> Iterator[Decision]:
        """Yield all decisions by tile, time and robot."""
        for tile in sorted(self._tiles):
            yield from self.about(tile)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, CellRecord) and self._tiles == other._tiles

    __hash__ = None  # type: ignore[assignment]  # it changes

    @property
    def robots(self) -> list[str]:
        """Return the names of the robots of which it has decisions."""
        return sorted(self._of)

    @property
    def tiles(self) -> list[int]:
        """Return the tiles with cells that robots have decided about."""
        return sorted(self._tiles)

    def about(self, tile: int) -> list[Decision]:
        """Return the decisions about a tile, the earliest first; no two are about one cell."""
        known = self._tiles.get(tile, {})
        return [known[rank] for rank in sorted(known)]

    def of(self, robot: str) -> list[Decision]:
        """Return the decisions of a robot, the earliest first."""
        return sorted(self._of.get(robot, {}).values(), key=lambda one: (one.stamp_ns, one.tile))

    def newest_of(self, robot: str) -> int:
        """Return the time of the newest decision of a robot [ns], 0 without one."""
        return max((one.stamp_ns for one in self._of.get(robot, {}).values()), default=0)

    def merge(self, decisions: Iterable[Decision]) -> set[int]:
        """Take in decisions of any age and order; return the tiles for which they matter."""
        return {one.tile for one in decisions if self._take(one)}

    def summaries(self) -> list[ContributorSummary]:
        """Return the summary of each robot's decisions, by robot."""
        for robot in self.robots:
            if robot not in self._summaries:
                self._summaries[robot] = ContributorSummary(
                    robot, self.newest_of(robot), len(self._of[robot]), self._digests[robot]
                )
        return [self._summaries[robot] for robot in self.robots]

    def _take(self, one: Decision) -> bool:
        known = list(self._tiles.get(one.tile, {}).values())
        later = 0
        for other in known:
            if other.rank > one.rank:
                later |= other.cells
        left = one.without(later)
        for other in known:
            if other.rank == left.rank:
                left = other.joined(left)
        if not left.cells or left in known:
            return False
        for other in known:
            if other.rank < left.rank and other.cells & left.cells:
                self._remove(other)
                self._add(other.without(left.cells))
            elif other.rank == left.rank:
                self._remove(other)
        self._add(left)
        return True

    def _add(self, one: Decision) -> None:
        if not one.cells:
            return
        self._tiles.setdefault(one.tile, {})[one.rank] = one
        self._of.setdefault(one.robot, {})[one.subject] = one
        self._note(one, 1)

    def _remove(self, one: Decision) -> None:
        tile, own = self._tiles[one.tile], self._of[one.robot]
        del tile[one.rank], own[one.subject]
        self._note(one, -1)
        if not tile:
            del self._tiles[one.tile]
        if not own:
            del self._of[one.robot], self._digests[one.robot]

    def _note(self, one: Decision, sign: int) -> None:
        # The sum does not depend on the order in which decisions came.
        digest = self._digests.get(one.robot, 0) + sign * _digest(one)
        self._digests[one.robot] = digest % _MOST_DIGEST
        self._summaries.pop(one.robot, None)


def _digest(one: Decision) -> int:
    content = (one.robot, one.tile, one.stamp_ns, one.free, one.occupied, one.unknown)
    return int.from_bytes(hashlib.blake2b(repr(content).encode(), digest_size=8).digest())
