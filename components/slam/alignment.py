"""Alignment of point clouds: iterated closest points, with distances to surfaces (Censi 2008)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.point_cloud import PointCloud
from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose, wrap

Array = NDArray[np.float64]

WIDE_M, NEAREST_M = 0.3, 0.12
"""Points are paired up to the first distance [m] where a pose is uncertain, and the second in the
end.
"""

# The distance up to which points are paired shrinks by this factor per iteration.
_SHRINK = 0.75
_ITERATIONS = 30
# An alignment has converged when a step is smaller than this share of its standard deviation.
_CONVERGED = 0.03
# Surfaces are paired if the angle between their normals is at most acos of this.
_SAME_SIDE = 0.7
# A direction counts as seen only as far as the surfaces across it outweigh this share of those
# across the other direction: the noise of their normals makes long walls look slightly rough.
_ROUGHNESS = 0.01
# Least standard deviation of a point's distance to its surface [m]. The points of one scan share
# their errors: the information counts so many times less.
NOISE_M, _COMMON = 0.02, 12.0
LEAST_INFORMATION = 1e-6 * np.eye(3)
"""Added to the information, so that it has an inverse where one wall says nothing of the position
along it: a deviation of 1 km, 1000 rad."""


class Reference:
    """A point cloud to which others are aligned, with an index of its points by position."""

    def __init__(self, cloud: PointCloud) -> None:
        self.cloud = cloud
        points = cloud.points
        self._origin = points.min(axis=0) - NEAREST_M if cloud.count else np.zeros(2)
        extent = points.max(axis=0) - self._origin if cloud.count else np.zeros(2)
        self._columns, self._rows = (math.floor(size / NEAREST_M) + 2 for size in extent)
        cells = np.floor((points - self._origin) / NEAREST_M).astype(np.int64)
        keys = cells[:, 1] * self._columns + cells[:, 0]
        self._order = np.argsort(keys, kind="stable")
        counts = np.bincount(keys, minlength=self._columns * self._rows)
        self._first = np.concatenate((np.zeros(1, np.int64), np.cumsum(counts)))
        self._points = np.ascontiguousarray(points[self._order])
        self._normals = np.ascontiguousarray(cloud.normals[self._order])

    def align(
        self,
        cloud: PointCloud,
        guess: Pose,
        prior: Array,
        reach: float = WIDE_M,
        robust: float = 0.05,
    ) -> Alignment:
        """Align a cloud to this reference.

        Args:
            cloud: the points in their own frame.
            guess: pose of that frame in this reference's frame, from which the search starts.
            prior: information (3, 3) of the guess over x, y [m] and heading [rad].
            reach: points are paired up to this distance [m] at first.
            robust: distance to the surface [m] at which a pair counts half as much.

        """
        state = np.array(guess)
        hessian, numbers = _align(
            cloud.points, cloud.normals, self._points, self._normals, self._first,
            self._origin, self._columns, self._rows, state, prior, reach, robust,
        )  # fmt: skip
        paired, flat, squares, fit, log_fit = numbers
        deviation = math.sqrt(squares / flat) if flat else math.inf
        noise = max(NOISE_M, deviation if flat else 0.0)
        return Alignment(
            pose=(float(state[0]), float(state[1]), wrap(float(state[2]))),
            information=hessian / (noise**2 * _COMMON) + LEAST_INFORMATION,
            fit=float(fit / max(1, cloud.count)),
            log_likelihood=float(log_fit / _COMMON),
            paired=float(paired / max(1, cloud.count)),
            pairs=int(flat),
            deviation=float(deviation),
        )


@dataclass(frozen=True)
class Alignment:
    """The pose of a cloud in the frame of its reference.

    Attributes:
        pose: x, y [m], heading [rad].
        information: (3, 3) over x, y and heading, in the reference's frame; without the prior's.
        fit: mean of the points' weights, 1 if each lies on its surface, 0 for a point without a
            partner.
        log_likelihood: of the points, relative to that of a perfect fit.
        paired: share of the points that have a partner within 0.12 m.
        pairs: number of those on a surface.
        deviation: root mean square of their distances to the surface [m].

    """

    pose: Pose
    information: Array
    fit: float
    log_likelihood: float
    paired: float
    pairs: int
    deviation: float


@compiled(
    "Tuple((float64[:, ::1], float64[::1]))(float64[:, ::1], float64[:, ::1], float64[:, ::1],"
    " float64[:, ::1], int64[::1], float64[::1], int64, int64, float64[::1], float64[:, ::1],"
    " float64, float64)"
)
def _align(
    points: Array,
    normals: Array,
    reference: Array,
    reference_normals: Array,
    first: NDArray[np.int64],
    origin: Array,
    columns: int,
    rows: int,
    state: Array,
    prior: Array,
    reach: float,
    robust: float,
) -> tuple[Array, Array]:
    x0, y0, t0 = state[0], state[1], state[2]
    x, y, turn = x0, y0, t0
    hessian = np.zeros((3, 3))
    numbers = np.zeros(5)
    log_least = -math.log(1.0 + (NEAREST_M / robust) ** 2)
    for _ in range(_ITERATIONS):
        cosine, sine = math.cos(turn), math.sin(turn)
        hessian[:] = 0.0
        gx, gy, gt = 0.0, 0.0, 0.0
        paired, flat, squares, fit, log_fit = 0, 0, 0.0, 0.0, 0.0
        scale = max(robust, 0.4 * reach) if reach > NEAREST_M else robust
        for i in range(len(points)):
            rx = cosine * points[i, 0] - sine * points[i, 1]
            ry = sine * points[i, 0] + cosine * points[i, 1]
            px, py = x + rx, y + ry
            nx = cosine * normals[i, 0] - sine * normals[i, 1]
            ny = sine * normals[i, 0] + cosine * normals[i, 1]
            is_flat = normals[i, 0] != 0.0 or normals[i, 1] != 0.0
            best, nearest = -1, reach * reach
            low_column = max(0, math.floor((px - reach - origin[0]) / NEAREST_M))
            high_column = min(columns - 1, math.floor((px + reach - origin[0]) / NEAREST_M))
            low_row = max(0, math.floor((py - reach - origin[1]) / NEAREST_M))
            high_row = min(rows - 1, math.floor((py + reach - origin[1]) / NEAREST_M))
            for row in range(low_row, high_row + 1):
                start = first[row * columns + low_column] if low_column <= high_column else 0
                stop = first[row * columns + high_column + 1] if low_column <= high_column else 0
                for k in range(start, stop):
                    dx, dy = px - reference[k, 0], py - reference[k, 1]
                    squared = dx * dx + dy * dy
                    if squared >= nearest:
                        continue
                    mx, my = reference_normals[k, 0], reference_normals[k, 1]
                    if is_flat and (mx != 0.0 or my != 0.0) and mx * nx + my * ny < _SAME_SIDE:
                        continue
                    best, nearest = k, squared
            if best < 0:
                log_fit += log_least
                continue
            paired += 1
            mx, my = reference_normals[best, 0], reference_normals[best, 1]
            if mx == 0.0 and my == 0.0:
                if not is_flat:
                    weight = 1.0 / (1.0 + nearest / (robust * robust))
                    fit += weight
                    log_fit += math.log(weight)
                    continue
                mx, my = nx, ny
            dx, dy = px - reference[best, 0], py - reference[best, 1]
            error = mx * dx + my * dy
            flat += 1
            squares += error * error
            weight = 1.0 / (1.0 + (error / scale) * (error / scale))
            fit += weight
            log_fit += math.log(weight)
            weight *= weight
            jt = my * rx - mx * ry
            hessian[0, 0] += weight * mx * mx
            hessian[0, 1] += weight * mx * my
            hessian[0, 2] += weight * mx * jt
            hessian[1, 1] += weight * my * my
            hessian[1, 2] += weight * my * jt
            hessian[2, 2] += weight * jt * jt
            gx += weight * mx * error
            gy += weight * my * error
            gt += weight * jt * error
        # The less certain direction of the position, turned by `angle` from the y axis.
        angle = 0.5 * math.atan2(2.0 * hessian[0, 1], hessian[0, 0] - hessian[1, 1])
        ux, uy = math.cos(angle), math.sin(angle)
        strong = ux * ux * hessian[0, 0] + 2.0 * ux * uy * hessian[0, 1] + uy * uy * hessian[1, 1]
        weak = uy * uy * hessian[0, 0] - 2.0 * ux * uy * hessian[0, 1] + ux * ux * hessian[1, 1]
        share = max(0.0, 1.0 - _ROUGHNESS * strong / weak) if weak > 0.0 else 0.0
        ut = ux * hessian[0, 2] + uy * hessian[1, 2]
        vt = (ux * hessian[1, 2] - uy * hessian[0, 2]) * math.sqrt(share)
        weak *= share
        hessian[0, 0] = ux * ux * strong + uy * uy * weak
        hessian[0, 1] = ux * uy * (strong - weak)
        hessian[1, 1] = uy * uy * strong + ux * ux * weak
        hessian[0, 2], hessian[1, 2] = ux * ut - uy * vt, uy * ut + ux * vt
        hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
        gu, gv = ux * gx + uy * gy, (ux * gy - uy * gx) * share
        gx, gy = ux * gu - uy * gv, uy * gu + ux * gv
        numbers[:] = np.array((paired, flat, squares, fit, log_fit))
        # With the prior, which counts as if all points were independent.
        noise = NOISE_M * NOISE_M * _COMMON
        ex, ey = x - x0, y - y0
        et = (turn - t0 + math.pi) % (2.0 * math.pi) - math.pi
        a = hessian + noise * prior
        bx = gx + noise * (prior[0, 0] * ex + prior[0, 1] * ey + prior[0, 2] * et)
        by = gy + noise * (prior[1, 0] * ex + prior[1, 1] * ey + prior[1, 2] * et)
        bt = gt + noise * (prior[2, 0] * ex + prior[2, 1] * ey + prior[2, 2] * et)
        c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
        c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
        c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
        determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
        if not determinant > 1e-12:
            break
        c11 = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
        c12 = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
        c22 = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
        step_x = -(c00 * bx + c01 * by + c02 * bt) / determinant
        step_y = -(c01 * bx + c11 * by + c12 * bt) / determinant
        step_turn = -(c02 * bx + c12 * by + c22 * bt) / determinant
        x += step_x
        y += step_y
        turn += step_turn
        is_small = -(step_x * bx + step_y * by + step_turn * bt) < _CONVERGED**2 * noise
        if reach <= NEAREST_M and is_small:
            break
        reach = max(NEAREST_M, reach * _SHRINK)
        if is_small:
            reach = NEAREST_M
    state[0], state[1], state[2] = x, y, turn
    return hessian, numbers
