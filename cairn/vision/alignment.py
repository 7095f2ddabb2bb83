"""Disparities finer than a pixel: patches of two images aligned by least squares.

Lucas and Kanade, An Iterative Image Registration Technique with an Application to Stereo Vision,
IJCAI 1981; with a disparity that is affine in the patch, as that of a slanted plane is.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

_ROUNDS = 8
# From the whole disparity that it starts from, no true one lies further [px].
_FURTHEST = 1.5
# Aligned patches that are less alike (normalized correlation) show different things.
_ALIKE = 0.8
# How disparity may change within a patch [px per px]: a surface turned by 45 degrees at a distance
# of ten baselines has 0.1. Without it, patches with little texture would tilt at will.
_SLANT = 0.2
# Noise of an image as a share of its patch's contrast: the weight of images against that prior.
_NOISE = 0.1


def aligned(left: Gray, right: Gray, points: Array, start: Array, half: int) -> Array:
    """The disparities (n,) [px] at `points` (n, 2) of the left image, NaN where patches differ.

    `start` (n,) [px] are those disparities within a pixel; patches have 2 * half + 1 pixels a side.
    """
    if not len(points):
        return np.zeros(0)
    ahead = np.arange(-half, half + 1, dtype=np.float64)
    across, down = (axis.ravel() for axis in np.meshgrid(ahead, ahead))
    model = np.column_stack((np.ones(across.size), across, down))
    columns = points[:, :1] + across
    rows = points[:, 1:] + down
    wanted, _ = _normalized(_sampled(left.astype(np.float32), columns, rows))
    target = right.astype(np.float32)
    slope = np.asarray(
        cv2.filter2D(target, cv2.CV_32F, np.array([[-0.5, 0.0, 0.5]], np.float32)), np.float32
    )
    prior = (_NOISE**2) * np.diag((0.0, _SLANT**-2, _SLANT**-2))
    found = np.column_stack((start, np.zeros_like(start), np.zeros_like(start)))
    for _ in range(_ROUNDS):
        at = columns - found @ model.T
        seen, contrast = _normalized(_sampled(target, at, rows))
        gradient = _sampled(slope, at, rows) / contrast[:, None]
        gradient -= gradient.mean(axis=1, keepdims=True)
        # Patches move left as the disparity grows: d(seen) = -gradient * d(disparity).
        jacobian = -gradient[:, :, None] * model
        normal = np.einsum("npi,npj->nij", jacobian, jacobian) + prior
        normal += 1e-9 * np.eye(3)
        right_side = np.einsum("npi,np->ni", jacobian, wanted - seen) - found @ prior
        found += np.linalg.solve(normal, right_side[:, :, None])[:, :, 0]
    seen, _ = _normalized(_sampled(target, columns - found @ model.T, rows))
    alike = np.mean(wanted * seen, axis=1)
    good = (np.abs(found[:, 0] - start) <= _FURTHEST) & (alike >= _ALIKE)
    return np.where(good, found[:, 0], np.nan)


def _sampled(image: NDArray[np.float32], columns: Array, rows: Array) -> Array:
    """Values (n, m) at places between the pixels of an image; at the border those of the border."""
    height, width = image.shape
    x = np.clip(columns, 0.0, width - 1.001)
    y = np.clip(rows, 0.0, height - 1.001)
    left, top = x.astype(np.int64), y.astype(np.int64)
    x -= left
    y -= top
    flat = image.ravel()
    corner = top * width + left
    above = flat[corner] * (1.0 - x) + flat[corner + 1] * x
    below = flat[corner + width] * (1.0 - x) + flat[corner + width + 1] * x
    values: Array = above * (1.0 - y) + below * y
    return values


def _normalized(patches: Array) -> tuple[Array, Array]:
    """Patches (n, m) with mean 0 and deviation 1, and the deviations (n,) that they had."""
    contrast = np.maximum(patches.std(axis=1), 1e-6)
    return (patches - patches.mean(axis=1, keepdims=True)) / contrast[:, None], contrast
