"""Poses in the plane and their composition; angles in radians, lengths in meters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Pose = tuple[float, float, float]
"""x [m], y [m], heading [rad, counterclockwise positive] in some frame."""


def wrap(angle: float) -> float:
    """Return an angle [rad] wrapped to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def wrap_all(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles [rad] wrapped to [-pi, pi)."""
    return (angles + math.pi) % (2.0 * math.pi) - math.pi


def compose(first: Pose, then: Pose) -> Pose:
    """Return the pose after the step `then`, which is given in the frame of the pose `first`."""
    x, y, theta = first
    cosine, sine = math.cos(theta), math.sin(theta)
    return (
        x + cosine * then[0] - sine * then[1],
        y + sine * then[0] + cosine * then[1],
        wrap(theta + then[2]),
    )


def inverse(pose: Pose) -> Pose:
    """Return the inverse step: `compose(pose, inverse(pose))` is the origin."""
    x, y, theta = pose
    cosine, sine = math.cos(theta), math.sin(theta)
    return (-cosine * x - sine * y, sine * x - cosine * y, wrap(-theta))


def relative(origin: Pose, pose: Pose) -> Pose:
    """Return `pose` in the frame `origin`: `compose(origin, relative(origin, pose))` is `pose`."""
    dx, dy = pose[0] - origin[0], pose[1] - origin[1]
    cosine, sine = math.cos(origin[2]), math.sin(origin[2])
    return (cosine * dx + sine * dy, cosine * dy - sine * dx, wrap(pose[2] - origin[2]))


def distance(a: Pose, b: Pose) -> float:
    """Return the distance [m] between the positions of two poses."""
    return math.hypot(a[0] - b[0], a[1] - b[1])


def apart(a: Pose, b: Pose, meters: float, radians: float) -> bool:
    """Return whether two poses differ by more than this in position or in heading."""
    return distance(a, b) > meters or abs(wrap(a[2] - b[2])) > radians


def between(a: Pose, b: Pose, share: float) -> Pose:
    """Return the pose at `share` (0 to 1) of the straight line from `a` to `b`."""
    turn = wrap(b[2] - a[2])
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        wrap(a[2] + share * turn),
    )
