"""How far each cell of a grid is from the nearest obstacle."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def distance_field(obstacles: NDArray[np.bool_], resolution: float) -> NDArray[np.float32]:
    """Distance [m] of each cell's center to that of the nearest obstacle cell, exact.

    Infinite everywhere if there is none. `obstacles` (rows, columns); Felzenszwalb and
    Huttenlocher 2012, as OpenCV's precise distance transform.
    """
    if not obstacles.any():
        return np.full(obstacles.shape, np.inf, np.float32)
    free = np.logical_not(obstacles).view(np.uint8)
    # Intel's routine in its place rounds by where in memory the arrays lie: not the same each time.
    used = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(False)
    try:
        cells = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    finally:
        cv2.ipp.setUseIPP(used)
    field: NDArray[np.float32] = np.asarray(cells, np.float32) * np.float32(resolution)
    return field
