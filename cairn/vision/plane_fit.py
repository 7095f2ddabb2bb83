"""An affine function fitted to values in the image, most of which agree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TRIALS = 200
# Values this near to the function agree with it [px of disparity]...
_NEAR = 1.0
# ...and in the end those within this many deviations, no fewer than this share and number.
_DEVIATIONS = 3.0
_LEAST_SHARE, _LEAST = 0.6, 6
# Disparities of single patches are no better than this [px].
_FLOOR = 0.1


@dataclass(frozen=True)
class PlaneFit:
    """value = c[0] + c[1] * x + c[2] * y, with the `covariance` (3, 3) of `coefficients` (3,)."""

    coefficients: Array
    covariance: Array
    agree: NDArray[np.bool_]


def fit_plane(points: Array, values: Array) -> PlaneFit | None:
    """The affine function of `points` (n, 2) that most of `values` (n,) agree with.

    RANSAC (Fischler and Bolles 1981) for those that agree, then least squares. None if fewer than
    six, or fewer than 60 % of them agree, or all points are on a line.
    """
    count = len(values)
    if count < _LEAST:
        return None
    model = np.column_stack((np.ones(count), points))
    triples = _triples(count)
    corners = model[triples]
    spread = np.abs(np.linalg.det(corners))
    triples, corners = triples[spread > 1.0], corners[spread > 1.0]
    if not len(triples):
        return None
    planes = np.linalg.solve(corners, values[triples][:, :, None])[:, :, 0]
    off = np.abs(planes @ model.T - values)
    # MSAC (Torr and Zisserman 2000): of those that agree, the nearer the better.
    best = int(np.minimum(off, _NEAR).sum(axis=1).argmin())
    agree = off[best] <= _NEAR
    for _ in range(5):
        if np.count_nonzero(agree) < max(_LEAST, _LEAST_SHARE * count):
            return None
        coefficients, *_ = np.linalg.lstsq(model[agree], values[agree], rcond=None)
        residuals = model @ coefficients - values
        deviation = max(_FLOOR, 1.4826 * float(np.median(np.abs(residuals[agree]))))
        agree = np.abs(residuals) <= _DEVIATIONS * deviation
    used = model[agree]
    # Less 2: what is estimated from few residuals is itself uncertain (Student's t).
    freedom = len(used) - 5
    variance = max(_FLOOR**2, float(np.sum(residuals[agree] ** 2)) / freedom)
    covariance = variance * np.linalg.pinv(used.T @ used)
    return PlaneFit(coefficients, covariance, agree)


@lru_cache(maxsize=256)
def _triples(count: int) -> NDArray[np.int64]:
    """Rows of three of so many points (trials, 3): the same points give the same fit.

    Kept, as to draw them takes longer than all the rest, and numbers of matches recur.
    """
    random = np.random.default_rng(count)
    triples = np.array([random.choice(count, 3, replace=False) for _ in range(_TRIALS)])
    triples.flags.writeable = False
    return triples
