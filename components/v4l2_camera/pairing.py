"""Pairing of left and right images by the times at which two cameras captured them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from cairn.components.v4l2_camera.decoding import Gray

UNPAIRED_KEPT = 3


@dataclass(frozen=True)
class StampedImage:
    """A gray image (h, w), when its camera captured it, and its stamp in messages.

    `captured` is CLOCK_MONOTONIC as reported by the camera's kernel driver, by which images are
    paired, and `stamp` the system's time [ns].
    """

    gray: Gray
    captured: int
    stamp: int


class StereoPairer:
    """Pairs each image with the one that the other camera captured at the nearest time.

    Cameras that are not synchronized drift against each other, so sequence numbers do not help. Two
    images further apart than `tolerance` [ns], which may be changed, are not paired: half a period
    is the greatest distance of the nearest ones. `unpaired` counts images, left and right, without
    a partner; in the last pair the right image was captured `offset` [ns] after the left one.
    """

    def __init__(self, tolerance: int) -> None:
        self.tolerance = tolerance
        self._unpaired: tuple[deque[StampedImage], deque[StampedImage]] = (deque(), deque())
        self.pairs = 0
        self.unpaired = [0, 0]
        self.offset = 0

    def add(self, side: int, image: StampedImage) -> tuple[StampedImage, StampedImage] | None:
        """Add an image of the left (0) or the right (1) camera; return the pair that it makes."""
        own, others = self._unpaired[side], self._unpaired[1 - side]
        nearest = min(others, key=lambda other: abs(other.captured - image.captured), default=None)
        if nearest is None or abs(nearest.captured - image.captured) > self.tolerance:
            own.append(image)
            if len(own) > UNPAIRED_KEPT:
                own.popleft()
                self.unpaired[side] += 1
            return None
        while others.popleft() is not nearest:  # older ones find no partner any more
            self.unpaired[1 - side] += 1
        self.unpaired[side] += len(own)
        own.clear()
        left, right = (image, nearest) if side == 0 else (nearest, image)
        self.pairs += 1
        self.offset = right.captured - left.captured
        return left, right
