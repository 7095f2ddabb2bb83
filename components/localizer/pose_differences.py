"""When two poses are different: one measure for all rules of the localizer."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, apart

LEVER_M: Final = 0.75
"""A turn of 1 rad is as large a difference as so many meters of the way."""
ANOTHER_M: Final = 0.15
"""Measurements from poses this far apart [m] have errors of their own.

Beams end in other cells of the map, and objects appear elsewhere in the image. The map builder uses
the same distances (`INDEPENDENT_M`).
"""
PLACE_M: Final = 0.5
"""The width of a place [m]: about that of a robot."""
SLIP_M: Final = 0.3
"""How far a robot moves unnoticed by odometry [m], standard deviation: held or pushed for half a
second at 0.6 m/s, or while a driver restarts.
"""


def slip_covariance() -> NDArray[np.float64]:
    """Return the covariance (3, 3) [m^2, rad^2] of what a slip adds to the motion."""
    return np.diag(np.square([SLIP_M, SLIP_M, SLIP_M / LEVER_M]))


def place_bin() -> NDArray[np.float64]:
    """Return half the width of a place, in x [m], y [m] and heading [rad]."""
    return 0.5 * PLACE_M * np.array([1.0, 1.0, 1.0 / LEVER_M])


def is_another(a: Pose, b: Pose) -> bool:
    """Whether what is measured from two poses has errors of its own."""
    return _differ(a, b, ANOTHER_M)


def is_same(a: Pose, b: Pose) -> bool:
    """Whether two poses belong to one place: each is within half a place of the other."""
    return not _differ(a, b, 0.5 * PLACE_M)


def is_elsewhere(a: Pose, b: Pose) -> bool:
    """Whether a whole place lies between the places of two poses."""
    return _differ(a, b, 2.0 * PLACE_M)


def _differ(a: Pose, b: Pose, meters: float) -> bool:
    return apart(a, b, meters, meters / LEVER_M)
