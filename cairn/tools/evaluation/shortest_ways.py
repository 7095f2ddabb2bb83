"""How long the shortest way between two places of a world is: exact, by a visibility graph."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

Place = tuple[float, float]
_Array = NDArray[np.float64]

# Ways may touch what stands: it is thinned by so much [m].
_TOUCH_M = 1e-6
# Pieces of a quarter of a circle. They are chords: ways are too short by 0.1 % round a corner.
_PIECES = 12


class ShortestWays:
    """Ways of a round robot of `radius` [m] among segments (m, 4) x1, y1, x2, y2 [m].

    Of shapes alone: it shares nothing with the planner that it is the yardstick for. A taut string
    goes straight from corner to corner of what stands, grown by the radius (Lozano-Perez and
    Wesley, 1979).
    """

    def __init__(self, segments: _Array, radius: float) -> None:
        self._standing = shapely.union_all(shapely.linestrings(segments.reshape(-1, 2, 2)))
        grown = self._standing.buffer(radius, quad_segs=_PIECES)
        self._solid = grown.buffer(-_TOUCH_M)
        self._corners, self._before, self._after = _convex_corners(grown)
        shapely.prepare(self._standing)
        shapely.prepare(self._solid)
        count = len(self._corners)
        self._lengths = np.full((count, count), math.inf)
        for one in range(count):
            self._lengths[one, one + 1 :] = self._seen(self._corners[one], one + 1, one)
        self._lengths = np.minimum(self._lengths, self._lengths.T)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x, least y, most x, most y [m] of all that stands."""
        left, bottom, right, top = self._standing.bounds
        return float(left), float(bottom), float(right), float(top)

    def room(self, place: Place) -> float:
        """How far [m] what stands is from a place."""
        return float(self._standing.distance(shapely.Point(place)))

    def length(self, start: Place, goal: Place) -> float:
        """Length [m] of the shortest way; infinite if there is none."""
        straight = shapely.LineString([start, goal])
        if not self._solid.intersects(straight):
            return float(straight.length)
        nearest = self._seen(np.array(start), 0, None)
        last = self._seen(np.array(goal), 0, None)
        best = math.inf
        open_ = np.ones(len(nearest), bool)
        while True:  # Dijkstra's algorithm
            here = int(np.argmin(np.where(open_, nearest, math.inf)))
            if not open_[here] or nearest[here] >= best:
                return best
            open_[here] = False
            best = min(best, float(nearest[here] + last[here]))
            np.minimum(nearest, nearest[here] + self._lengths[here], out=nearest)

    def _seen(self, place: _Array, first: int, corner: int | None) -> _Array:
        """Lengths [m] of straight ways from a place to the corners from `first` on.

        Infinite where there is none, or where no taut string would go on round the corner.
        """
        ends = self._corners[first:]
        taut = _tangent(ends - place, self._before[first:], self._after[first:])
        if corner is not None:
            taut &= _tangent(ends - place, self._before[corner], self._after[corner])
        lengths = np.full(len(ends), math.inf)
        chosen = np.flatnonzero(taut)
        rays = np.stack((np.broadcast_to(place, (len(chosen), 2)), ends[chosen]), axis=1)
        free = chosen[~shapely.intersects(self._solid, shapely.linestrings(rays))]
        lengths[free] = np.hypot(*(ends[free] - place).T)
        return lengths


def _convex_corners(grown: shapely.Geometry) -> tuple[_Array, _Array, _Array]:
    """Where strings bend: corners (n, 2) that stick out, with the sides before and after each."""
    corners, before, after = [], [], []
    for part in shapely.get_parts(grown):
        part = shapely.orient_polygons(part)  # what stands is to the left of each side
        for ring in (part.exterior, *part.interiors):
            points = np.array(ring.coords)[:-1]
            coming, going = points - np.roll(points, 1, 0), np.roll(points, -1, 0) - points
            out = _cross(coming, going) > 0
            corners.append(points[out])
            before.append(coming[out])
            after.append(going[out])
    return np.concatenate(corners), np.concatenate(before), np.concatenate(after)


def _tangent(way: _Array, before: _Array, after: _Array) -> NDArray[np.bool_]:
    """Whether ways only touch corners with these sides, and so may bend there."""
    return _cross(way, before) * _cross(way, after) <= 0


def _cross(a: _Array, b: _Array) -> _Array:
    product: _Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
