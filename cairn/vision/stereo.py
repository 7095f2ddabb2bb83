"""A rectified stereo pair: its geometry, and disparities of points to a fraction of a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.vision.rectification import CameraModel

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

HALF = 7
"""Patches have 2 * HALF + 1 pixels a side."""

# Least normalized correlation of a match.
_SIMILAR = 0.75
# A match is ambiguous if a second peak is within this margin of correlation...
_MARGIN = 0.04
# ...and farther than the width of a correlation peak [px].
_PEAK = 3
# Least contrast of a patch (standard deviation) [gray levels]: less is a blank wall with noise.
_CONTRAST = 2.0
# Largest error of matching back from right to left [px].
_RETURN = 1.0
# A larger disparity comes from something near, not from an error of rectification [px].
_MOVED = 1.0
# Vertical offsets of the right image are searched within this range [px].
_ROWS = 5
# Fewest points, and least share of them that agree, for a statement about a whole image.
_FEWEST, _AGREE = 8, 0.7
# Rows and focal lengths of a rectified pair agree, apart from rounding in their file.
_SAME_PX = 0.01
_LEAST_BASELINE_M = 0.005  # no two cameras are nearer to each other
# Alignment of patches: iterations, and largest change of the disparity that it starts from [px].
_ALIGN_ROUNDS, _ALIGN_REACH = 8, 1.5
# Aligned patches with a smaller normalized correlation show different things.
_ALIGN_SIMILAR = 0.8
# Change of disparity within a patch [px per px]: a surface at 45 degrees at a distance of ten
# baselines has 0.1. Without this prior, patches with little texture would tilt freely.
_ALIGN_SLANT = 0.2
# Image noise as a share of the patch's contrast: the weight of the images against that prior.
_ALIGN_NOISE = 0.1


@dataclass(frozen=True)
class StereoRig:
    """A rectified pair: `fx`, `fy`, `cx`, `cy` [px] of the left camera, `baseline` [m].

    `offset` [px] is the disparity at infinite distance: 0 unless cx differs left and right.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float
    width: int
    height: int
    offset: float = 0.0

    @classmethod
    def of(cls, left: CameraInfo, right: CameraInfo) -> StereoRig:
        """Return the rig of two calibrations; raise `CairnError` if they are not a pair."""
        a, b = CameraModel.of(left), CameraModel.of(right)
        if (a.width, a.height) != (b.width, b.height):
            raise CairnError(
                f"the left camera is calibrated for {a.width} x {a.height} pixels, the right one "
                f"for {b.width} x {b.height}; a stereo pair needs images of one size"
            )
        p, q = a.projection, b.projection
        rows = max(abs(p[1, 1] - q[1, 1]), abs(p[1, 2] - q[1, 2]), abs(p[1, 3] - q[1, 3]))
        if rows > _SAME_PX or abs(p[0, 0] - q[0, 0]) > _SAME_PX:
            raise CairnError(
                "rows of the left and the right image are not aligned: fx, fy and cy of p are "
                f"{p[0, 0]:.2f}, {p[1, 1]:.2f}, {p[1, 2]:.2f} left and {q[0, 0]:.2f}, "
                f"{q[1, 1]:.2f}, {q[1, 2]:.2f} right; calibrate the two cameras together with "
                "`cairn camera calibrate`"
            )
        baseline = float((p[0, 3] - q[0, 3]) / p[0, 0])
        if abs(baseline) < _LEAST_BASELINE_M:
            raise CairnError(
                "the cameras have no baseline: p[3] of the right one must be -fx * baseline, in "
                f"pixels times meters, but is {q[0, 3]:g}; calibrate the two cameras together with "
                "`cairn camera calibrate`"
            )
        if baseline < 0 or abs(p[0, 3]) > _SAME_PX:
            raise CairnError(
                f"left and right are swapped: p[3] is {p[0, 3]:g} left and {q[0, 3]:g} right, but "
                "must be 0 left and negative right; swap the cameras, or their calibrations"
            )
        offset = float(p[0, 2] - q[0, 2])
        return cls(
            float(p[0, 0]),
            float(p[1, 1]),
            float(p[0, 2]),
            float(p[1, 2]),
            baseline,
            a.width,
            a.height,
            offset,
        )

    def nearest_disparity(self, nearest: float) -> float:
        """Return the disparity [px] at `nearest` [m] depth, at most half the image's width."""
        return min(self.fx * self.baseline / nearest, self.width / 2)


def disparities(
    left: Gray,
    right: Gray,
    points: NDArray[np.floating],
    rig: StereoRig,
    *,
    least: float = -1.0,
    most: float | None = None,
) -> Array:
    """Return the disparities (n,) [px] of `points` (n, 2) [px] of the left image.

    The images (h, w) are rectified. A disparity is x in the left image less x in the right one;
    depth is fx * baseline / disparity. It is NaN where a point has no match, several matches, or
    one that does not match back to it. Disparities from `least` to `most` are searched; `most` is
    by default that of 0.3 m. Raises `CairnError` if the images are not of the rig's size.
    """
    for side, image in (("left", left), ("right", right)):
        if image.shape != (rig.height, rig.width):
            raise CairnError(
                f"the {side} image is {image.shape[1]} x {image.shape[0]} pixels, but the cameras "
                f"are calibrated for {rig.width} x {rig.height}"
            )
    centers = np.asarray(points, np.float64).reshape(-1, 2)
    most = rig.nearest_disparity(0.3) if most is None else most
    low, high = int(np.floor(least + rig.offset)), int(np.ceil(most + rig.offset))
    whole = np.rint(centers).astype(np.int64)
    coarse = _match(left, right, whole, low, high)
    found = np.flatnonzero(~np.isnan(coarse))
    there = whole[found] - np.column_stack((coarse[found], np.zeros(len(found)))).astype(np.int64)
    back = _match(right, left, there, -high, -low)
    found = found[np.abs(coarse[found] + back) <= _RETURN]
    result = np.full(len(centers), np.nan)
    result[found] = align(left, right, centers[found], coarse[found], HALF) - rig.offset
    return result


def rows_off(left: Gray, right: Gray, points: NDArray[np.floating], rig: StereoRig) -> float:
    """Return by how many rows [px] the right image shows `points` (n, 2) lower than the left one.

    It is 0 in a rectified pair, and also if fewer than 8 points can be matched or they disagree.
    """
    offs = []
    reach = HALF + _ROWS
    high, low = math.ceil(rig.nearest_disparity(0.3) + rig.offset), math.floor(rig.offset - 1.0)
    for u, v in np.rint(np.asarray(points, np.float64)).astype(int).tolist():
        begin, end = max(u - high, HALF), min(u - low, rig.width - 1 - HALF)
        inside = reach <= v < rig.height - reach and HALF <= u < rig.width - HALF
        if not inside or begin > end:
            continue
        patch = left[v - HALF : v + HALF + 1, u - HALF : u + HALF + 1]
        strip = right[v - reach : v + reach + 1, begin - HALF : end + HALF + 1]
        if patch.std() < _CONTRAST:
            continue
        scores = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)
        row, _ = np.unravel_index(int(scores.argmax()), scores.shape)
        if scores.max() >= _SIMILAR:
            offs.append(int(row) - _ROWS)
    if len(offs) < _FEWEST:
        return 0.0
    off = float(np.median(offs))
    return off if np.mean(np.abs(np.array(offs) - off) <= 1.0) > _AGREE else 0.0


def are_swapped(left: Gray, right: Gray, points: NDArray[np.floating], rig: StereoRig) -> bool:
    """Return whether `left` was taken by the right camera: disparities have the wrong sign.

    Only points with a clear disparity count. The result is False if fewer than 8 can be matched.
    """
    most = rig.nearest_disparity(0.3)
    found = disparities(left, right, points, rig, least=-most, most=most)
    against = int(np.count_nonzero(found < -_MOVED))
    return against >= _FEWEST and against > 3 * int(np.count_nonzero(found > _MOVED))


def _match(source: Gray, target: Gray, points: NDArray[np.int64], low: int, high: int) -> Array:
    """Return whole disparities (n,) by which pixels (n, 2) of `source` are right of `target`'s."""
    result = np.full(len(points), np.nan)
    height, width = source.shape
    for index, (u, v) in enumerate(points.tolist()):
        begin, end = max(u - high, HALF), min(u - low, width - 1 - HALF)
        inside = HALF <= u < width - HALF and HALF <= v < height - HALF
        if not inside or begin > end:
            continue
        rows = slice(v - HALF, v + HALF + 1)
        patch = source[rows, u - HALF : u + HALF + 1]
        if patch.std() < _CONTRAST:
            continue
        strip = target[rows, begin - HALF : end + HALF + 1]
        scores = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)[0]
        best = int(scores.argmax())
        others = np.concatenate((scores[: max(best - _PEAK, 0)], scores[best + _PEAK + 1 :]))
        ambiguous = others.size > 0 and others.max() > scores[best] - _MARGIN
        if scores[best] >= _SIMILAR and not ambiguous:
            result[index] = u - (begin + best)
    return result


def align(left: Gray, right: Gray, points: Array, start: Array, half: int) -> Array:
    """Refine disparities (n,) [px] at `points` (n, 2) of the left image by least squares.

    Patches of 2 * half + 1 pixels per side are aligned (Lucas and Kanade, An Iterative Image
    Registration Technique with an Application to Stereo Vision, IJCAI 1981), with a disparity that
    is affine in the patch, as that of a slanted plane is. `start` (n,) [px] are the disparities
    within a pixel. The result is NaN where patches differ.
    """
    if not len(points):
        return np.zeros(0)
    ahead = np.arange(-half, half + 1, dtype=np.float64)
    across, down = (axis.ravel() for axis in np.meshgrid(ahead, ahead))
    model = np.column_stack((np.ones(across.size), across, down))
    columns = points[:, :1] + across
    rows = points[:, 1:] + down
    reference, _ = _normalize(_sample(left.astype(np.float32), columns, rows))
    target = right.astype(np.float32)
    slope = np.asarray(
        cv2.filter2D(target, cv2.CV_32F, np.array([[-0.5, 0.0, 0.5]], np.float32)), np.float32
    )
    prior = (_ALIGN_NOISE**2) * np.diag((0.0, _ALIGN_SLANT**-2, _ALIGN_SLANT**-2))
    found = np.column_stack((start, np.zeros_like(start), np.zeros_like(start)))
    for _ in range(_ALIGN_ROUNDS):
        at = columns - found @ model.T
        sampled, contrast = _normalize(_sample(target, at, rows))
        gradient = _sample(slope, at, rows) / contrast[:, None]
        gradient -= gradient.mean(axis=1, keepdims=True)
        # Patches move left as the disparity grows: d(sampled) = -gradient * d(disparity).
        jacobian = -gradient[:, :, None] * model
        normal = np.einsum("npi,npj->nij", jacobian, jacobian) + prior
        normal += 1e-9 * np.eye(3)
        right_side = np.einsum("npi,np->ni", jacobian, reference - sampled) - found @ prior
        found += np.linalg.solve(normal, right_side[:, :, None])[:, :, 0]
    sampled, _ = _normalize(_sample(target, columns - found @ model.T, rows))
    alike = np.mean(reference * sampled, axis=1)
    good = (np.abs(found[:, 0] - start) <= _ALIGN_REACH) & (alike >= _ALIGN_SIMILAR)
    return np.where(good, found[:, 0], np.nan)


def _sample(image: NDArray[np.float32], columns: Array, rows: Array) -> Array:
    """Interpolate an image between its pixels; beyond the border, use the border's values."""
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


def _normalize(patches: Array) -> tuple[Array, Array]:
    """Return patches (n, m) with mean 0 and standard deviation 1, and their deviations before."""
    contrast = np.maximum(patches.std(axis=1), 1e-6)
    return (patches - patches.mean(axis=1, keepdims=True)) / contrast[:, None], contrast
