"""From the camera's axes to the plane of the robot: range, bearing, and what is in view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vision.ranging import Located
from vision.stereo import StereoRig

Array = NDArray[np.float64]
Pose = tuple[float, float, float]

# An object whose middle is nearer to the image's edge than this share of it is seen in part.
_EDGE = 0.1
# So much nearer than the farthest, and farther than the nearest, an object is surely in range.
_SURELY = 0.1


@dataclass(frozen=True)
class Place:
    """`range` [m] and `bearing` [rad, left positive] from the robot, with their covariance."""

    range: float
    bearing: float
    covariance: Array


@dataclass(frozen=True)
class Field:
    """Where objects can be recognised: bearings [rad, left positive] and ranges [m]."""

    right: float = 0.0
    left: float = 0.0
    nearest: float = 0.0
    farthest: float = 0.0


NOWHERE = Field()


def place_of(located: Located, mount: Pose) -> Place:
    """Where in the plane something is that was located from the camera at `mount`."""
    x, y, theta = mount
    cosine, sine = math.cos(theta), math.sin(theta)
    # The optical frame's x is to the right and its z ahead.
    turn = np.array([[sine, cosine], [-cosine, sine]])
    ahead, aside = turn @ located.position[[0, 2]] + (x, y)
    distance = math.hypot(ahead, aside)
    to_polar = np.array(
        [[ahead / distance, aside / distance], [-aside / distance**2, ahead / distance**2]]
    )
    jacobian = to_polar @ turn
    covariance = jacobian @ located.covariance[np.ix_((0, 2), (0, 2))] @ jacobian.T
    return Place(distance, math.atan2(aside, ahead), (covariance + covariance.T) / 2)


def field_of(rig: StereoRig, mount: Pose, nearest: float, farthest: float) -> Field:
    """Where seen from the robot an object of whatever range is in the image.

    Bearings of a camera that looks backwards may be beyond pi: right is always less than left.
    """
    x, y, theta = mount
    margin = _EDGE * rig.width
    to_left = theta + math.atan((rig.cx - margin) / rig.fx)
    to_right = theta - math.atan((rig.width - 1 - margin - rig.cx) / rig.fx)
    left, right = math.inf, -math.inf
    nearest, farthest = (1 + _SURELY) * nearest, (1 - _SURELY) * farthest
    for away in (nearest, farthest):
        left = min(left, _bearing(x, y, to_left, away))
        right = max(right, _bearing(x, y, to_right, away))
    return Field(right, left, nearest, farthest) if right < left and nearest < farthest else NOWHERE


def _bearing(x: float, y: float, direction: float, away: float) -> float:
    """The bearing from the robot of what is in a direction from the camera, near that direction."""
    seen = math.atan2(y + away * math.sin(direction), x + away * math.cos(direction))
    return direction + math.remainder(seen - direction, 2 * math.pi)
