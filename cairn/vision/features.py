"""Local features of an image: SIFT keypoints with RootSIFT descriptors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

LARGEST = 2_000_000
"""Pixels of the largest image that is looked at as it is; larger ones are scaled down to that."""

DESCRIPTOR = 128
"""Numbers in a descriptor."""

# Gray levels from the darkest to the brightest hundredth of an image that is worth calling lit; the
# level of the darkest; the gain that gets it there, at most; and one that is not worth it.
_SPAN, _LOWEST, _MOST_GAIN, _ENOUGH = 200.0, 10.0, 6.0, 1.3

_QUANTISATION = 512.0  # as usual for SIFT: no element of a unit descriptor comes near 0.5


@dataclass(frozen=True)
class Features:
    """The n features of one image, what stands out most first.

    `points` (n, 2) are x right and y down [px], (0, 0) the middle of the top left pixel; `scales`
    (n,) the diameters of what was described [px]; `angles` (n,) its directions [rad], clockwise
    from x; `descriptors` (n, 128) the square roots of SIFT's histograms (Arandjelovic and
    Zisserman 2012), so that Euclidean distance between them is Hellinger's between histograms.
    """

    points: NDArray[np.float32]
    scales: NDArray[np.float32]
    angles: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)

    def at(self, indices: NDArray[np.intp] | NDArray[np.bool_]) -> Features:
        """Only these features."""
        return Features(
            self.points[indices],
            self.scales[indices],
            self.angles[indices],
            self.descriptors[indices],
        )


def extract(gray: NDArray[np.uint8], most: int = 0) -> Features:
    """The features of a gray image (h, w), of any size; the `most` that stand out most, or all (0).

    An image of more than `LARGEST` pixels is scaled down first, so that what is to be told about
    it is told in bounded time; its features are given in pixels of the image itself. Raises
    `ValueError` if it is no such image.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise ValueError(f"a gray image is uint8 (h, w), not {gray.dtype} {gray.shape}")
    if not gray.size:
        return none()
    factor = math.sqrt(LARGEST / gray.size)
    if factor < 1.0:
        height, width = gray.shape
        smaller = (max(1, round(width * factor)), max(1, round(height * factor)))
        gray = cv2.resize(gray, smaller, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
        stretch = np.array([width / smaller[0], height / smaller[1]])
    else:
        stretch = np.ones(2)
    gray = _in_good_light(gray)
    # The precise upscaling: without it all points lie a quarter of a pixel off.
    sift = cv2.SIFT.create(nfeatures=most, enable_precise_upscale=True)
    keypoints, histograms = sift.detectAndCompute(gray, None)
    if histograms is None or not keypoints:
        return none()
    table = np.array([(*k.pt, k.size, k.angle, k.response) for k in keypoints], np.float64)
    order = np.lexsort((*table[:, :4].T, -table[:, 4]))
    order = order[: most or len(order)]
    table = table[order]
    return Features(
        ((table[:, :2] + 0.5) * stretch - 0.5).astype(np.float32),
        (table[:, 2] * math.sqrt(float(stretch.prod()))).astype(np.float32),
        np.deg2rad(table[:, 3]).astype(np.float32),
        _rooted(histograms[order].astype(np.float32, copy=False)),
    )


def _in_good_light(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image whose gray levels span much, made of one that is dark or without contrast.

    What stands out is measured in gray levels, so in bad light nothing would. The gain is at most
    `_MOST_GAIN`: beyond it there is more noise than image.
    """
    low, high = np.percentile(gray[::4, ::4], [1.0, 99.0])
    gain = min(_MOST_GAIN, _SPAN / max(high - low, 1.0))
    if gain <= _ENOUGH:
        return gray
    levels = np.clip((np.arange(256) - low) * gain + _LOWEST, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(gray, levels), np.uint8)


def varied(features: Features, most: int) -> Features:
    """At most so many of the features, of all sizes alike, those that stand out most.

    From far away only the coarse ones of an object are seen: they are few and do not stand out.
    """
    octaves = np.floor(np.log2(np.maximum(features.scales, 1.0)))
    ranks = np.zeros(len(features), np.int64)
    for octave in np.unique(octaves):
        same = octaves == octave
        ranks[same] = np.arange(same.sum())
    return features.at(np.sort(np.argsort(ranks, kind="stable")[:most]))


def none() -> Features:
    """No features: those of a blank image."""
    return Features(
        np.zeros((0, 2), np.float32),
        np.zeros(0, np.float32),
        np.zeros(0, np.float32),
        np.zeros((0, DESCRIPTOR), np.uint8),
    )


def _rooted(histograms: NDArray[np.float32]) -> NDArray[np.uint8]:
    sums = np.maximum(histograms.sum(axis=1, keepdims=True), 1e-6)
    rooted: NDArray[np.float32] = np.rint(np.sqrt(histograms / sums) * _QUANTISATION)
    return np.minimum(rooted, 255.0).astype(np.uint8)
