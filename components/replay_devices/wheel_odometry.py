"""Velocities and uncertainty of recorded wheel odometry, estimated from its poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import wrap_all

Array = NDArray[np.float64]


def odometry_velocities(stamps: Sequence[int], poses: Array) -> Array:
    """Return velocities (n, 2: forward [m/s], turn [rad/s]) from the previous pose to each one.

    They are 0 for the first pose, and where no time passes.
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


def velocities_agree(stamps: Sequence[int], poses: Array, twists: Array) -> bool:
    """Return whether recorded velocities add up to the motion of the poses, within a fifth."""
    seconds = _seconds(stamps)
    recorded = np.abs(twists[1:] * seconds[:, None]).sum(axis=0)
    forward, turned = _steps(poses)
    moved = np.array([np.abs(forward).sum(), np.abs(turned).sum()])
    return bool(np.all(np.abs(recorded - moved) <= 0.2 * moved + (0.5, 0.5)))


def odometry_deviations(poses: Array) -> Array:
    """Return standard deviations (n, 2: position [m], heading [rad]) of poses (n, 3).

    They grow with the motion since the first pose: 1 % of the distance; a heading that veers by
    0.02 rad per meter, drifts by 0.03 rad per square root of a meter, and misses 3 % of the turns.
    These are the errors of the Freiburg recordings fr079 and fr101 against corrected poses.
    """
    forward, turned = _steps(poses)
    distance = np.concatenate(([0.0], np.cumsum(np.abs(forward))))
    turns = np.concatenate(([0.0], np.cumsum(turned)))
    turn_sd = np.sqrt((0.02 * distance) ** 2 + 0.03**2 * distance + (0.03 * turns) ** 2)
    position_sd = np.sqrt((0.01 * distance) ** 2 + (0.5 * turn_sd * distance) ** 2)
    return np.stack([position_sd, turn_sd], axis=1)


def _seconds(stamps: Sequence[int]) -> Array:
    return np.diff(np.array(stamps, dtype=np.int64)).astype(np.float64) / 1e9


def _steps(poses: Array) -> tuple[Array, Array]:
    """Return the forward distance [m] and the left turn [rad] of each step (n - 1)."""
    turned = wrap_all(np.diff(poses[:, 2]))
    middle = poses[:-1, 2] + 0.5 * turned
    dx, dy = np.diff(poses[:, 0]), np.diff(poses[:, 1])
    return np.cos(middle) * dx + np.sin(middle) * dy, turned
