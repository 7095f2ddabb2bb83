"""A rectified stereo pair: its geometry, and the disparities of points seen in both images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.vision.alignment import aligned
from cairn.vision.rectification import Lens

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

HALF = 7
"""Patches have 2 * HALF + 1 pixels a side."""

# A match this weak (normalized correlation) is none.
_ALIKE = 0.75
# Another place that looks as alike, less this, makes a match ambiguous...
_MARGIN = 0.04
# ...if it is further away than this [px]: a peak of correlation is that wide.
_PEAK = 3
# A patch of less contrast (standard deviation) is of a blank wall, matched by noise [gray levels].
_CONTRAST = 2.0
# How far the way back from right to left may miss the point [px].
_RETURN = 1.0
# A disparity of more is that of something near by, however the rectification is off [px].
_MOVED = 1.0
# Rows that the right image may be off are looked for so far up and down [px].
_ROWS = 5
# Fewer points tell nothing of an image, nor do those of which no larger share agrees.
_FEWEST, _AGREE = 8, 0.7
# Rows and focal lengths of a rectified pair agree, but for what is lost in writing them down.
_SAME_PX = 0.01


@dataclass(frozen=True)
class StereoRig:
    """A rectified pair: `fx`, `fy`, `cx`, `cy` [px] of the left camera, `baseline` [m].

    `offset` [px] is the disparity of what is infinitely far: 0 unless cx differs left and right.
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
        """The rig of two cameras calibrated together; raises `CairnError` if they are none."""
        a, b = Lens.of(left), Lens.of(right)
        if (a.width, a.height) != (b.width, b.height):
            raise CairnError(
                f"the left camera is calibrated for {a.width} x {a.height} pixels, the right one "
                f"for {b.width} x {b.height}: a stereo pair needs images of one size"
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
        if abs(baseline) < 1e-4:
            raise CairnError(
                "the cameras have no baseline: p[3] of the right one must be -fx * baseline, "
                f"but is {q[0, 3]:g}; calibrate the two cameras together with "
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
        """The disparity [px] of what is `nearest` [m] ahead, at most half the image's width."""
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
    """How far right of where the right camera saw them lie `points` (n, 2) of the left image [px].

    The images (h, w) are rectified. The result (n,) is NaN where a point has no match, several, or
    one that does not lead back to it. Disparities from `least` to `most` are looked for; `most` is
    by default that of 0.3 m. Depth is fx * baseline / disparity. Raises `CairnError` if the images
    are not of the rig's size.
    """
    for side, image in (("left", left), ("right", right)):
        if image.shape != (rig.height, rig.width):
            raise CairnError(
                f"the {side} image is {image.shape[1]} x {image.shape[0]} pixels, but the cameras "
                f"are calibrated for {rig.width} x {rig.height}"
            )
    places = np.asarray(points, np.float64).reshape(-1, 2)
    most = rig.nearest_disparity(0.3) if most is None else most
    low, high = int(np.floor(least + rig.offset)), int(np.ceil(most + rig.offset))
    whole = np.rint(places).astype(np.int64)
    coarse = _matched(left, right, whole, low, high)
    found = np.flatnonzero(~np.isnan(coarse))
    there = whole[found] - np.column_stack((coarse[found], np.zeros(len(found)))).astype(np.int64)
    back = _matched(right, left, there, -high, -low)
    found = found[np.abs(coarse[found] + back) <= _RETURN]
    result = np.full(len(places), np.nan)
    result[found] = aligned(left, right, places[found], coarse[found], HALF) - rig.offset
    return result


def rows_off(left: Gray, right: Gray, points: NDArray[np.floating], rig: StereoRig) -> float:
    """By how many rows [px] lower the right image shows `points` (n, 2) of the left one.

    In a rectified pair none; 0 also where too few points tell (fewer than 8), or do not agree.
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
        if scores.max() >= _ALIKE:
            offs.append(int(row) - _ROWS)
    if len(offs) < _FEWEST:
        return 0.0
    off = float(np.median(offs))
    return off if np.mean(np.abs(np.array(offs) - off) <= 1.0) > _AGREE else 0.0


def look_swapped(left: Gray, right: Gray, points: NDArray[np.floating], rig: StereoRig) -> bool:
    """Whether `left` was taken by the right camera: points have moved in the wrong direction.

    Those that have moved at all tell, what is far away has not. False also where too few (fewer
    than 8) can be matched to say.
    """
    most = rig.nearest_disparity(0.3)
    found = disparities(left, right, points, rig, least=-most, most=most)
    against = int(np.count_nonzero(found < -_MOVED))
    return against >= _FEWEST and against > 3 * int(np.count_nonzero(found > _MOVED))


def _matched(source: Gray, target: Gray, points: NDArray[np.int64], low: int, high: int) -> Array:
    """Whole disparities (n,) by which pixels (n, 2) of `source` lie right of those of `target`."""
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
        if scores[best] >= _ALIKE and not ambiguous:
            result[index] = u - (begin + best)
    return result
