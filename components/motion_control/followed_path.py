"""The path that the robot follows, and the robot's progress on it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose

Array = NDArray[np.float64]

SPACING_M = 0.05
"""Distance [m] between the points of the path ahead: a cell of the usual map."""
HORIZON_M = 3.0
"""Length [m] of the path ahead that is considered: beyond the longest detour (`SEARCH_RANGE_M`)."""

# The robot's position on the path is searched this far behind and ahead of the last one [m], and
# everywhere if the robot is farther away than the third value [m]: so it stays on its branch where
# the path crosses itself. Chosen by hand; `lab/constants.yaml` has the effect of half and
# double.
_BEHIND, _BEFORE = 0.3, 1.0
_LOST = 0.8


class FollowedPath:
    """A polyline, and the robot's progress on it.

    `poses` (n, 3) in any frame; `goal` is its end with the final heading.
    """

    def __init__(self, poses: Array, goal: Pose) -> None:
        points = np.vstack((poses[:, :2], np.array([goal[:2]])))
        steps = np.hypot(*np.diff(points, axis=0).T)
        apart = np.concatenate(([True], steps > 1e-3))
        apart[-1] = True
        self._points = np.ascontiguousarray(points[apart])
        lengths = np.hypot(*np.diff(self._points, axis=0).T)
        self._along = np.concatenate(([0.0], np.cumsum(lengths)))
        self._way = np.empty((round(HORIZON_M / SPACING_M) + 2, 2))
        self._reached: float | None = None
        self.goal = goal
        self.off = 0.0
        """Distance [m] of the robot to the path at the last call of `ahead`."""

    @property
    def length(self) -> float:
        """Return the length [m] of the whole path."""
        return float(self._along[-1])

    @property
    def left(self) -> float:
        """Return the length [m] of the path from the robot on."""
        return self.length - (self._reached or 0.0)

    def ahead(self, robot: Pose) -> Array:
        """Return the path ahead (n, 2) [m] in the robot's frame, points `SPACING_M` apart.

        Valid until the next call.
        """
        x, y, theta = robot
        if self._reached is not None:
            low, high = self._reached - _BEHIND, self._reached + _BEFORE
            self._reached, self.off = _project(self._points, self._along, x, y, low, high)
        if self._reached is None or self.off > _LOST:
            self._reached, self.off = _project(self._points, self._along, x, y, -math.inf, math.inf)
        count = _ahead(self._points, self._along, self._reached, x, y, theta, self._way)
        return self._way[:count]


@compiled("UniTuple(float64, 2)(float64[:,::1], float64[::1], float64, float64, float64, float64)")
def _project(
    points: Array, along: Array, x: float, y: float, low: float, high: float
) -> tuple[float, float]:
    """Return the nearest position on the path between `low` and `high` [m], and the distance."""
    place, least = along[-1], math.inf
    for i in range(points.shape[0] - 1):
        length = along[i + 1] - along[i]
        if along[i + 1] < low or along[i] > high or length <= 0.0:
            continue
        ux, uy = (
            (points[i + 1, 0] - points[i, 0]) / length,
            (points[i + 1, 1] - points[i, 1]) / length,
        )
        dx, dy = x - points[i, 0], y - points[i, 1]
        t = min(max(ux * dx + uy * dy, max(0.0, low - along[i])), min(length, high - along[i]))
        apart = math.hypot(dx - t * ux, dy - t * uy)
        if apart < least:
            place, least = along[i] + t, apart
    if least == math.inf:
        end = points.shape[0] - 1
        least = math.hypot(x - points[end, 0], y - points[end, 1])
    return place, least


@compiled("int64(float64[:,::1], float64[::1], float64, float64, float64, float64, float64[:,::1])")
def _ahead(
    points: Array, along: Array, start: float, x: float, y: float, theta: float, way: Array
) -> int:
    """Fill `way` with points of the path from `start` [m] on in the frame of the pose."""
    cosine, sine = math.cos(theta), math.sin(theta)
    last = points.shape[0] - 1
    segment = 0
    count = 0
    while count < way.shape[0]:
        place = start + SPACING_M * count
        ended = place >= along[last]
        while segment < last - 1 and along[segment + 1] < place:
            segment += 1
        if ended:
            px, py = points[last, 0], points[last, 1]
        else:
            share = (place - along[segment]) / (along[segment + 1] - along[segment])
            px = points[segment, 0] + share * (points[segment + 1, 0] - points[segment, 0])
            py = points[segment, 1] + share * (points[segment + 1, 1] - points[segment, 1])
        way[count, 0] = cosine * (px - x) + sine * (py - y)
        way[count, 1] = cosine * (py - y) - sine * (px - x)
        count += 1
        if ended:
            break
    return count
