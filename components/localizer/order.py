"""Brings odometry and sightings, which come from different processes, into the order of stamps."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Held(Generic[T]):
    """Items by stamp [s], held until odometry has reached them, but not for ever."""

    def __init__(self, longest_s: float) -> None:
        self.longest_s = longest_s
        self._items: deque[tuple[float, T]] = deque()

    def add(self, stamp: float, item: T) -> bool:
        """Hold an item; False if it is older than the newest one held or released."""
        if self._items and stamp < self._items[-1][0]:
            return False
        self._items.append((stamp, item))
        return True

    def release(self, odometry: float, now: float) -> list[tuple[float, T]]:
        """The items that odometry has reached, and those held longer than the limit."""
        ready = []
        while self._items:
            stamp = self._items[0][0]
            if stamp > odometry and now - stamp <= self.longest_s:
                break
            ready.append(self._items.popleft())
        return ready

    @property
    def oldest(self) -> float | None:
        """The stamp of the item next to be released."""
        return self._items[0][0] if self._items else None

    def clear(self) -> None:
        """Forget what is held."""
        self._items.clear()
