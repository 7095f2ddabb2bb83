"""Finds taught objects in images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vision.features import Features
from vision.taught import TaughtObject


@dataclass(frozen=True)
class Recognition:
    """One instance of an object in one image.

    `view` says which of the object's views was matched, `homography` (3, 3) takes that view's
    pixels to the image's, `corners` (4, 2) [px] are the view's (top left, top right, bottom right,
    bottom left) in the image, possibly outside of it. `view_points` and `image_points` (n, 2) [px]
    are where the n matched features lie in both. `alternatives` are other taught objects that
    explain what is seen there about as well.
    """

    object_id: int
    name: str
    view: int
    homography: NDArray[np.float64]
    corners: NDArray[np.float64]
    view_points: NDArray[np.float64]
    image_points: NDArray[np.float64]
    alternatives: tuple[int, ...]

    @property
    def inliers(self) -> int:
        """How many features agree on where the object is."""
        return len(self.view_points)


class Recognizer:
    """What recognises a set of taught objects; built once for them, and never changed."""

    def __init__(self, objects: Sequence[TaughtObject]) -> None:
        self.objects = tuple(objects)

    def recognize(self, features: Features, width: int, height: int) -> list[Recognition]:
        """The objects in an image of `width` x `height` [px] with these features."""
        raise NotImplementedError(f"{len(features)} features, {width} x {height}")
