"""Object models: the appearance of a flat object in one photograph or more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import Features


@dataclass(frozen=True)
class ModelView:
    """One photograph of an object, cut to the object.

    `width` and `height` [px] are the size of `picture` (h, w), a gray image. `features` are the
    features that the recognizer matches, in pixels of the picture.
    """

    width: int
    height: int
    features: Features
    picture: NDArray[np.uint8]

    @property
    def corners(self) -> NDArray[np.float64]:
        """Return the corners (4, 2) [px]: top left, top right, bottom right, bottom left.

        They are the outer corners of the outermost pixels, half a pixel outside of their centers.
        """
        right, bottom = self.width - 0.5, self.height - 0.5
        return np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)])


@dataclass(frozen=True)
class ObjectModel:
    """The name, the size and the views of an object.

    `size` is the width and height [m] of what the views show, None if it is not known.
    """

    object_id: int
    name: str
    size: tuple[float, float] | None
    views: tuple[ModelView, ...]
