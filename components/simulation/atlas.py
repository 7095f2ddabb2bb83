"""Textures in the form in which columns of an image are cut out of them: sums along their rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.textures import surface_pattern

Float32 = NDArray[np.float32]

# The pattern of surfaces is texture 0; it repeats.
PATTERN = 0
# One of its texels covers so much [m].
TEXEL_M = 0.02


@dataclass(frozen=True)
class Atlas:
    """Textures side by side.

    Texture k has `shapes[k]` = width, height [texels]. Its sums along x from the left, column by
    column (width + 1, height), begin at `begins[k]` of `sums`; the mean over any part of a row is a
    difference of two of them. Of the pattern there are two widths, so that a part may go over its
    seam. `levels` has the pattern again, halved again and again, for planes seen aslant: level k
    is square, begins at `level_begins[k]`.
    """

    sums: Float32
    begins: NDArray[np.int64]
    shapes: NDArray[np.int64]
    levels: Float32
    level_begins: NDArray[np.int64]

    @staticmethod
    def of(pictures: Sequence[NDArray[np.uint8]]) -> Atlas:
        """The pattern, and pictures (h, w) as textures 1, 2, ..."""
        pattern = surface_pattern()
        parts = [_sums(np.hstack((pattern, pattern))), *(_sums(one) for one in pictures)]
        begins = np.cumsum([0, *(part.size for part in parts[:-1])])
        shapes = [pattern.shape[::-1], *(one.shape[::-1] for one in pictures)]
        levels = [pattern]
        while len(levels[-1]) > 1:
            half = len(levels[-1]) // 2
            halved = cv2.resize(levels[-1], (half, half), interpolation=cv2.INTER_AREA)
            levels.append(np.asarray(halved, np.float32))
        sizes = [level.size for level in levels[:-1]]
        return Atlas(
            np.concatenate([part.ravel() for part in parts]),
            begins.astype(np.int64),
            np.array(shapes, np.int64),
            np.concatenate([level.ravel() for level in levels]),
            np.cumsum([0, *sizes]).astype(np.int64),
        )


def _sums(picture: NDArray[np.uint8] | Float32) -> Float32:
    """Sums (w + 1, h) of all columns to the left of each."""
    sums = np.zeros((picture.shape[1] + 1, picture.shape[0]))
    np.cumsum(picture.T.astype(np.float64), axis=0, out=sums[1:])
    return sums.astype(np.float32)
