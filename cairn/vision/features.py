"""Local features of an image: SIFT keypoints with RootSIFT descriptors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

LARGEST = 2_000_000
"""Pixels of the largest image that is processed at full size; larger ones are scaled down."""

DESCRIPTOR = 128
"""Numbers in a descriptor."""

# Contrast stretching: gray levels between the 1st and 99th percentile of a well-lit image, the gray
# level of its 1st percentile, the largest gain, and the gain below which an image is left as it is.
_SPAN, _LOWEST, _MOST_GAIN, _ENOUGH = 200.0, 10.0, 6.0, 1.3

_QUANTIZATION = 512.0  # as usual for SIFT: no element of a unit descriptor comes near 0.5


@dataclass(frozen=True)
class Features:
    """The n features of one image, strongest response first.

    `points` (n, 2) are x right and y down [px] with (0, 0) at the center of the top left pixel;
    `scales` (n,) the diameters of the described regions [px]; `angles` (n,) their directions
    [rad], clockwise from x; `descriptors` (n, 128) the square roots of SIFT's histograms
    (Arandjelovic and Zisserman 2012), so that the Euclidean distance between descriptors is the
    Hellinger distance between histograms.
    """

    points: NDArray[np.float32]
    scales: NDArray[np.float32]
    angles: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)

    def at(self, indices: NDArray[np.intp] | NDArray[np.bool_]) -> Features:
        """Return only these features."""
        return Features(
            self.points[indices],
            self.scales[indices],
            self.angles[indices],
            self.descriptors[indices],
        )


def extract(gray: NDArray[np.uint8], most: int = 0) -> Features:
    """Return the features of a gray image (h, w): the `most` strongest, or all of them (0).

    An image of more than `LARGEST` pixels is scaled down first, so that extraction takes bounded
    time; its features are returned in pixels of the original image. Raises `ValueError` if `gray`
    is not a two-dimensional uint8 array.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise ValueError(f"a gray image must be uint8 (h, w), not {gray.dtype} {gray.shape}")
    if not gray.size:
        return no_features()
    factor = math.sqrt(LARGEST / gray.size)
    if factor < 1.0:
        height, width = gray.shape
        smaller = (max(1, round(width * factor)), max(1, round(height * factor)))
        gray = cv2.resize(gray, smaller, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
        stretch = np.array([width / smaller[0], height / smaller[1]])
    else:
        stretch = np.ones(2)
    gray = _with_contrast(gray)
    # Without precise upscaling all points are a quarter of a pixel off.
    sift = cv2.SIFT.create(nfeatures=most, enable_precise_upscale=True)
    keypoints, histograms = sift.detectAndCompute(gray, None)
    if histograms is None or not keypoints:
        return no_features()
    table = np.array([(*k.pt, k.size, k.angle, k.response) for k in keypoints], np.float64)
    order = np.lexsort((*table[:, :4].T, -table[:, 4]))
    order = order[: most or len(order)]
    table = table[order]
    return Features(
        ((table[:, :2] + 0.5) * stretch - 0.5).astype(np.float32),
        (table[:, 2] * math.sqrt(float(stretch.prod()))).astype(np.float32),
        np.deg2rad(table[:, 3]).astype(np.float32),
        _root_sift(histograms[order].astype(np.float32, copy=False)),
    )


def _with_contrast(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stretch the gray levels of a dark or low-contrast image.

    SIFT's response threshold is in gray levels, so it finds nothing in bad light. The gain is at
    most `_MOST_GAIN`: beyond it the image is more noise than signal.
    """
    low, high = np.percentile(gray[::4, ::4], [1.0, 99.0])
    gain = min(_MOST_GAIN, _SPAN / max(high - low, 1.0))
    if gain <= _ENOUGH:
        return gray
    levels = np.clip((np.arange(256) - low) * gain + _LOWEST, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(gray, levels), np.uint8)


def select_across_scales(features: Features, most: int) -> Features:
    """Return at most `most` features: the strongest of each octave of scale in turn.

    From far away only the coarse features of an object are visible; these are few, and their
    response is weak.
    """
    octaves = np.floor(np.log2(np.maximum(features.scales, 1.0)))
    ranks = np.zeros(len(features), np.int64)
    for octave in np.unique(octaves):
        same = octaves == octave
        ranks[same] = np.arange(same.sum())
    return features.at(np.sort(np.argsort(ranks, kind="stable")[:most]))


def no_features() -> Features:
    """Return empty features, as of a blank image."""
    return Features(
        np.zeros((0, 2), np.float32),
        np.zeros(0, np.float32),
        np.zeros(0, np.float32),
        np.zeros((0, DESCRIPTOR), np.uint8),
    )


def _root_sift(histograms: NDArray[np.float32]) -> NDArray[np.uint8]:
    sums = np.maximum(histograms.sum(axis=1, keepdims=True), 1e-6)
    rooted: NDArray[np.float32] = np.rint(np.sqrt(histograms / sums) * _QUANTIZATION)
    return np.minimum(rooted, 255.0).astype(np.uint8)
