"""Objects that were taught: flat things, each by one photograph or more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import Features


@dataclass(frozen=True)
class View:
    """One photograph of an object, cut to the object.

    `width` and `height` [px] are those of `picture` (h, w), which is gray; `features` are what is
    recognized of it, in its pixels.
    """

    width: int
    height: int
    features: Features
    picture: NDArray[np.uint8]

    @property
    def corners(self) -> NDArray[np.float64]:
        """(4, 2) [px]: top left, top right, bottom right, bottom left.

        The outer corners of the outermost pixels, whose middles are half a pixel further in.
        """
        right, bottom = self.width - 0.5, self.height - 0.5
        return np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)])


@dataclass(frozen=True)
class TaughtObject:
    """What is known of an object: its name, its size and what it looks like.

    `size` is width and height [m] of what the views show, None if it was not told.
    """

    object_id: int
    name: str
    size: tuple[float, float] | None
    views: tuple[View, ...]
