"""What can be said of recorded wheel odometry: its velocities, and how far it may be off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import wrap_all

Array = NDArray[np.float64]


def velocities(stamps: Sequence[int], poses: Array) -> Array:
    """Forward [m/s] and turn [rad/s] (n, 2) that led from each pose's forerunner to it.

    Zeros for the first pose, and where no time passes.
    """
    twists = np.zeros((len(poses), 2))
    if len(poses) < 2:
        return twists
    seconds = _seconds(stamps)
    forward, turned = _steps(poses)
    moved = seconds > 0
    twists[1:, 0][moved] = forward[moved] / seconds[moved]
    twists[1:, 1][moved] = turned[moved] / seconds[moved]
    return twists


def agree(stamps: Sequence[int], poses: Array, twists: Array) -> bool:
    """Whether recorded velocities add up to the way and the turns of the poses, within a fifth."""
    seconds = _seconds(stamps)
    told = np.abs(twists[1:] * seconds[:, None]).sum(axis=0)
    forward, turned = _steps(poses)
    made = np.array([np.abs(forward).sum(), np.abs(turned).sum()])
    return bool(np.all(np.abs(told - made) <= 0.2 * made + (0.5, 0.5)))


def deviations(poses: Array) -> Array:
    """Standard deviations (n, 2) of place [m] and turn [rad] of poses (n, 3), from the first on.

    By the way and the turns behind the robot: 1 % of the way; a heading that veers by 0.02 rad per
    meter, drifts by 0.03 rad per square root of a meter, and misses 3 % of the turns. That is what
    the wheels of the Freiburg recordings fr079 and fr101 were off against corrected poses.
    """
    forward, turned = _steps(poses)
    way = np.concatenate(([0.0], np.cumsum(np.abs(forward))))
    turns = np.concatenate(([0.0], np.cumsum(turned)))
    turn_sd = np.sqrt((0.02 * way) ** 2 + 0.03**2 * way + (0.03 * turns) ** 2)
    place_sd = np.sqrt((0.01 * way) ** 2 + (0.5 * turn_sd * way) ** 2)
    return np.stack([place_sd, turn_sd], axis=1)


def _seconds(stamps: Sequence[int]) -> Array:
    return np.diff(np.array(stamps, dtype=np.int64)).astype(np.float64) / 1e9


def _steps(poses: Array) -> tuple[Array, Array]:
    """How far ahead [m] and how far to the left [rad] each step went (n - 1)."""
    turned = wrap_all(np.diff(poses[:, 2]))
    middle = poses[:-1, 2] + 0.5 * turned
    dx, dy = np.diff(poses[:, 0]), np.diff(poses[:, 1])
    return np.cos(middle) * dx + np.sin(middle) * dy, turned
