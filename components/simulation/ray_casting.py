"""Ray casting: ranges of beams to walls, furniture and people, and clearances."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled

Array = NDArray[np.float64]
NOTHING = -1


def cast(
    starts: Array, angles: Array, segments: Array, circles: Array, reach: float
) -> tuple[Array, NDArray[np.int64]]:
    """Return ranges (n,) [m] of rays from `starts` (n, 2) [m] in directions `angles` (n,) [rad].

    The rays meet `segments` (m, 4) x1, y1, x2, y2 and `circles` (k, 3) x, y, radius [m]. The second
    result is the index of what was hit: of a segment, m + index of a circle, or -1 if nothing is
    within `reach` [m]; the range is infinite then.
    """
    ranges = np.empty(angles.size)
    hit = np.empty(angles.size, np.int64)
    _cast(starts, angles, segments, circles, reach, ranges, hit)
    return ranges, hit


def clearance(x: float, y: float, segments: Array, circles: Array) -> tuple[float, int]:
    """Return distance [m] and index of the nearest thing to a point; negative inside a circle."""
    return _clearance(x, y, segments, circles)


@compiled(
    "void(float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1], float64, float64[::1],"
    " int64[::1])"
)
def _cast(
    starts: Array,
    angles: Array,
    segments: Array,
    circles: Array,
    reach: float,
    ranges: Array,
    hit: NDArray[np.int64],
) -> None:
    for i in range(angles.size):
        x, y = starts[i, 0], starts[i, 1]
        cosine, sine = math.cos(angles[i]), math.sin(angles[i])
        best, what = reach, NOTHING
        for j in range(segments.shape[0]):
            # In the ray's own axes the segment crosses the ray where the lateral offset changes
            # sign.
            ax, ay = segments[j, 0] - x, segments[j, 1] - y
            bx, by = segments[j, 2] - x, segments[j, 3] - y
            off_a = cosine * ay - sine * ax
            off_b = cosine * by - sine * bx
            if (off_a > 0.0) == (off_b > 0.0):
                continue
            along_a = cosine * ax + sine * ay
            along_b = cosine * bx + sine * by
            along = along_a + (along_b - along_a) * off_a / (off_a - off_b)
            if 0.0 <= along < best:
                best, what = along, j
        for k in range(circles.shape[0]):
            dx, dy = circles[k, 0] - x, circles[k, 1] - y
            middle = cosine * dx + sine * dy
            off = cosine * dy - sine * dx
            left = circles[k, 2] * circles[k, 2] - off * off
            if left <= 0.0:
                continue
            half = math.sqrt(left)
            along = middle - half
            if along < 0.0 and middle + half > 0.0:
                along = 0.0  # the ray starts inside
            if 0.0 <= along < best:
                best, what = along, segments.shape[0] + k
        ranges[i] = best if what != NOTHING else math.inf
        hit[i] = what


@compiled("Tuple((float64, int64))(float64, float64, float64[:, ::1], float64[:, ::1])")
def _clearance(x: float, y: float, segments: Array, circles: Array) -> tuple[float, int]:
    best, what = math.inf, NOTHING
    for j in range(segments.shape[0]):
        ax, ay = segments[j, 0], segments[j, 1]
        dx, dy = segments[j, 2] - ax, segments[j, 3] - ay
        length = dx * dx + dy * dy
        share = 0.0
        if length > 0.0:
            share = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / length))
        apart = math.hypot(ax + share * dx - x, ay + share * dy - y)
        if apart < best:
            best, what = apart, j
    for k in range(circles.shape[0]):
        apart = math.hypot(circles[k, 0] - x, circles[k, 1] - y) - circles[k, 2]
        if apart < best:
            best, what = apart, segments.shape[0] + k
    return best, what
