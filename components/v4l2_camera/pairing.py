"""Pairs of pictures that two cameras have taken at the same time, as nearly as they do."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from cairn.components.v4l2_camera.pixels import Gray

_WAITING = 3


@dataclass(frozen=True)
class Picture:
    """A gray picture (h, w), when its camera took it, and the stamp that messages get.

    `taken` is CLOCK_MONOTONIC as the camera's driver told it, which pictures are paired by, and
    `stamp` the system's time [ns].
    """

    gray: Gray
    taken: int
    stamp: int


class Pairing:
    """Pairs each picture with the one of the other camera that was taken nearest to it.

    Cameras that are not synchronized drift against each other, so numbers of pictures tell nothing.
    Two pictures further apart than `within` [ns], which may be changed, are none of a pair: half a
    period is as far as the nearest can be. `unpaired` counts pictures, left and right, that found
    no other; of the last pair the right one was taken `apart` [ns] after the left one.
    """

    def __init__(self, within: int) -> None:
        self.within = within
        self._waiting: tuple[deque[Picture], deque[Picture]] = (deque(), deque())
        self.pairs = 0
        self.unpaired = [0, 0]
        self.apart = 0

    def add(self, side: int, picture: Picture) -> tuple[Picture, Picture] | None:
        """Take a picture of the left (0) or the right (1) camera; gives the pair that it makes."""
        own, others = self._waiting[side], self._waiting[1 - side]
        nearest = min(others, key=lambda one: abs(one.taken - picture.taken), default=None)
        if nearest is None or abs(nearest.taken - picture.taken) > self.within:
            own.append(picture)
            if len(own) > _WAITING:
                own.popleft()
                self.unpaired[side] += 1
            return None
        while others.popleft() is not nearest:  # what is older finds no other any more
            self.unpaired[1 - side] += 1
        self.unpaired[side] += len(own)
        own.clear()
        left, right = (picture, nearest) if side == 0 else (nearest, picture)
        self.pairs += 1
        self.apart = right.taken - left.taken
        return left, right
