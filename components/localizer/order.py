"""Brings odometry, scans and sightings, which come from different processes, into one order."""

from __future__ import annotations

from bisect import insort
from typing import Generic, TypeVar

T = TypeVar("T")


class Held(Generic[T]):
    """Items by stamp [s], held until odometry has reached them, but not for ever."""

    def __init__(self, longest_s: float) -> None:
        self.longest_s = longest_s
        self._items: list[tuple[float, int, T]] = []
        self._count = 0

    def add(self, stamp: float, item: T) -> None:
        """Hold an item; of equal stamps the earlier comes first."""
        self._count += 1
        insort(self._items, (stamp, self._count, item), key=lambda entry: entry[:2])

    def release(self, odometry: float, now: float) -> list[tuple[float, T]]:
        """The items that odometry has reached, and those held longer than the limit."""
        ready = []
        while self._items:
            stamp = self._items[0][0]
            if stamp > odometry and now - stamp <= self.longest_s:
                break
            ready.append((stamp, self._items.pop(0)[2]))
        return ready

    @property
    def oldest(self) -> float | None:
        """The stamp of the item next to be released."""
        return self._items[0][0] if self._items else None
