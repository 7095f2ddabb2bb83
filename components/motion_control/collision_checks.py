"""Collision checks: how far a round robot can drive along arcs, lines and paths among points.

Everywhere `radius` [m] is that of the circle to keep free, and `least` [m] that of the robot. A
point that is inside the circle at the start must not come nearer than it is then; a point inside
the robot itself, as noise makes it appear, blocks motions toward it and lets the robot leave.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled

Array = NDArray[np.float64]

UNLIMITED_M = 10.0
"""Free length and clearance [m] where nothing limits them: farther than points are kept (4 m)."""

_STRAIGHT = 1e-3  # curvature [1/m] below which an arc counts as a straight line
_SLACK = 0.005  # [m] by which a point inside the circle may come nearer, as scans are noisy


@compiled()
def _kept_distance(squared: float, radius: float, least: float) -> float:
    """Return the distance [m] to keep from a point with this squared distance at the start."""
    if squared >= radius * radius:
        return radius
    return max(least, math.sqrt(squared) - _SLACK)


@compiled(
    "void(float64[:,::1], float64[::1], float64[::1], float64, float64, float64[::1], float64[::1])"
)
def check_arcs(
    points: Array,
    curvatures: Array,
    lengths: Array,
    radius: float,
    least: float,
    free: Array,
    clear: Array,
) -> None:
    """Check arcs that a circle drives ahead.

    `points` (n, 2) [m] in the robot's frame; `curvatures` (m,) [1/m], left positive. Fills `free`
    (m,) [m] with the arc length up to the first contact, and `clear` (m,) [m] with the least
    distance of a point to the center's path over `lengths` (m,) [m].
    """
    for j in range(curvatures.size):
        bend, length = abs(curvatures[j]), lengths[j]
        side = 1.0 if curvatures[j] >= 0.0 else -1.0
        straight = bend < _STRAIGHT
        turn = 1.0 if straight else 1.0 / bend
        most = length / turn
        end_x, end_y = turn * math.sin(most), turn * (1.0 - math.cos(most))
        way, nearest = UNLIMITED_M, UNLIMITED_M * UNLIMITED_M
        for i in range(points.shape[0]):
            x, y = points[i, 0], side * points[i, 1]
            here = x * x + y * y
            nearest = min(nearest, here)
            keep = _kept_distance(here, radius, least)
            if here < keep * keep:
                if x > 0.0:
                    way = 0.0
                continue
            if straight:
                beyond = x - min(max(x, 0.0), length)
                nearest = min(nearest, beyond * beyond + y * y)
                if x > 0.0 and y * y < keep * keep:
                    way = min(way, x - math.sqrt(keep * keep - y * y))
                continue
            ex, ey = x - end_x, y - end_y
            nearest = min(nearest, ex * ex + ey * ey)
            down = turn - y
            apart = math.sqrt(x * x + down * down)
            off = apart - turn
            touches = abs(off) < keep
            if not touches and off * off >= nearest:
                continue
            angle = math.atan2(x, down)
            if 0.0 <= angle <= most:
                nearest = min(nearest, off * off)
            if touches and apart > 0.0:
                cosine = (turn * turn + apart * apart - keep * keep) / (2.0 * turn * apart)
                angle -= math.acos(min(1.0, max(-1.0, cosine)))
                if angle < 0.0:
                    angle += 2.0 * math.pi
                way = min(way, turn * angle)
        free[j] = way
        clear[j] = math.sqrt(nearest)


def free_arc(points: Array, curvature: float, radius: float, least: float) -> float:
    """Return the length [m] that a circle can drive ahead along one arc, see `check_arcs`."""
    free, clear = np.empty(1), np.empty(1)
    check_arcs(points, np.array([curvature]), np.zeros(1), radius, least, free, clear)
    return float(free[0])


@compiled("void(float64[:,::1], float64[::1], float64, float64, float64[::1])")
def check_lines(points: Array, directions: Array, radius: float, least: float, free: Array) -> None:
    """Fill `free` with the length [m] that a circle can drive in `directions` (m,) [rad]."""
    for j in range(directions.size):
        cosine, sine = math.cos(directions[j]), math.sin(directions[j])
        way = UNLIMITED_M
        for i in range(points.shape[0]):
            px, py = points[i, 0], points[i, 1]
            x, y = cosine * px + sine * py, cosine * py - sine * px
            if x <= 0.0 or abs(y) >= radius:
                continue
            keep = _kept_distance(px * px + py * py, radius, least)
            if abs(y) < keep:
                way = min(way, max(0.0, x - math.sqrt(keep * keep - y * y)))
        free[j] = way


@compiled()
def _circle_fits(points: Array, x: float, y: float, radius: float) -> bool:
    """Return whether a circle fits at x, y, or does not come nearer to points in contact."""
    squared = radius * radius
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        dx, dy = px - x, py - y
        apart = dx * dx + dy * dy
        if apart < squared:
            here = px * px + py * py
            if here >= squared or apart < (math.sqrt(here) - _SLACK) ** 2:
                return False
    return True


@compiled("float64(float64[:,::1], float64[:,::1], float64, float64)")
def free_length(points: Array, way: Array, spacing: float, radius: float) -> float:
    """Return how far [m] a circle can drive along `way` (n, 2) with points `spacing` [m] apart."""
    for k in range(way.shape[0]):
        if not _circle_fits(points, way[k, 0], way[k, 1], radius):
            return spacing * k
    return UNLIMITED_M


@compiled("int64(float64[:,::1], float64[:,::1], int64, int64, float64)")
def first_free_again(points: Array, way: Array, first: int, run: int, radius: float) -> int:
    """Return the first index of `way` from `first` on where a circle fits, or -1.

    It must fit on the `run` next points as well.

    At the end of the way fewer points suffice.
    """
    fits = 0
    for k in range(first, way.shape[0]):
        fits = fits + 1 if _circle_fits(points, way[k, 0], way[k, 1], radius) else 0
        if fits > run:
            return k - run
    return way.shape[0] - fits if fits > 0 else -1


@compiled("void(float64[:,::1], float64[:,::1], float64, float64, float64, boolean[::1])")
def check_straight_lines(
    points: Array, places: Array, x: float, y: float, radius: float, free: NDArray[np.bool_]
) -> None:
    """Fill `free` (m,): from which of `places` (m, 2) a circle can drive straight to x, y."""
    squared = radius * radius
    for j in range(places.shape[0]):
        px, py = places[j, 0], places[j, 1]
        ux, uy = x - px, y - py
        length = math.hypot(ux, uy)
        if length > 0.0:
            ux, uy = ux / length, uy / length
        free[j] = True
        for i in range(points.shape[0]):
            dx, dy = points[i, 0] - px, points[i, 1] - py
            along = ux * dx + uy * dy
            beyond = along - min(max(along, 0.0), length)
            across = ux * dy - uy * dx
            apart = beyond * beyond + across * across
            if apart < squared:
                here = points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1]
                if here >= squared or apart < (math.sqrt(here) - _SLACK) ** 2:
                    free[j] = False
                    break
