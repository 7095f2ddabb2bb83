"""Covariance matrices in messages: row-major, finite, symmetric, positive semidefinite."""

from itertools import chain
from math import isfinite
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from cairn.schemas.primitives import Array

_TOLERANCE = 1e-9  # relative to the largest entry: more than rounding, less than any error


def _check2(array: npt.NDArray[Any]) -> None:
    a, b, c, d = array.tolist()
    largest = max(abs(a), abs(b), abs(c), abs(d))
    if not isfinite(a + b + c + d) and not all(map(isfinite, (a, b, c, d))):
        raise ValueError("must hold finite numbers only")
    if largest == 0.0:
        return
    a, b, c, d = a / largest, b / largest, c / largest, d / largest
    if abs(b - c) > _TOLERANCE:
        raise ValueError("must be symmetric")
    if a < -_TOLERANCE or d < -_TOLERANCE or a * d - b * c < -_TOLERANCE:
        raise ValueError("must be positive semidefinite")


def _check3(array: npt.NDArray[Any]) -> None:
    values = array.tolist()
    if not all(map(isfinite, values)):
        raise ValueError("must hold finite numbers only")
    largest = max(map(abs, values))
    if largest == 0.0:
        return
    a, b, c, d, e, f, g, h, i = (value / largest for value in values)
    if max(abs(b - d), abs(c - g), abs(f - h)) > _TOLERANCE:
        raise ValueError("must be symmetric")
    # A symmetric matrix is positive semidefinite if and only if all principal minors are.
    minors = chain(
        (a, e, i),
        (a * e - b * d, a * i - c * g, e * i - f * h),
        (a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g),),
    )
    if min(minors) < -_TOLERANCE:
        raise ValueError("must be positive semidefinite")


Covariance2 = Annotated[npt.NDArray[np.float64], Array("float64", length=4, check=_check2)]
"""Row-major 2x2."""

Covariance3 = Annotated[npt.NDArray[np.float64], Array("float64", length=9, check=_check3)]
"""Row-major 3x3."""
