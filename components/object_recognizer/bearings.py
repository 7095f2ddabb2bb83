"""From the camera's axes to the plane of the robot: range, bearing, and what is in view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.vision.ranging import Located
from cairn.vision.stereo import StereoRig

Array = NDArray[np.float64]
Pose = tuple[float, float, float]

# An object whose middle is nearer to the image's edge than this share of it is seen in part.
_EDGE = 0.1
# So much nearer than the farthest, and farther than the nearest, an object is surely in range.
_SURELY = 0.1
_STEPS = 12


@dataclass(frozen=True)
class Place:
    """`range` [m] and `bearing` [rad, left positive] from the robot, with their covariance."""

    range: float
    bearing: float
    covariance: Array


@dataclass(frozen=True)
class Field:
    """Where objects can be recognized: bearings [rad, left positive] and ranges [m]."""

    right: float = 0.0
    left: float = 0.0
    nearest: float = 0.0
    farthest: float = 0.0


NOWHERE = Field()


def place_of(located: Located, mount: Pose, bearing_sd: float = 0.0) -> Place:
    """Where in the plane something is that was located from the camera at `mount`.

    `bearing_sd` [rad] is how well it is known where the camera was looking at that moment.
    """
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
    covariance = (covariance + covariance.T) / 2 + np.diag((0.0, bearing_sd**2))
    return Place(distance, math.atan2(aside, ahead), covariance)


def field_of(rig: StereoRig, mount: Pose, nearest: float, farthest: float) -> Field:
    """Where seen from the robot an object is in the image, whatever its range.

    A camera that is not in the robot's middle sees other bearings near by: `nearest` is taken as
    much farther as needed to leave half of its view. Bearings of a camera that looks backwards may
    be beyond pi: right is always less than left.
    """
    margin = _EDGE * rig.width
    to_left = mount[2] + math.atan((rig.cx - margin) / rig.fx)
    to_right = mount[2] - math.atan((rig.width - 1 - margin - rig.cx) / rig.fx)
    farthest *= 1 - _SURELY
    lefts, rights = _bearing(mount, to_left, farthest), _bearing(mount, to_right, farthest)
    for near in np.geomspace((1 + _SURELY) * nearest, farthest, _STEPS)[:-1].tolist():
        if near <= math.hypot(mount[0], mount[1]):
            continue
        left = min(lefts, _bearing(mount, to_left, near))
        right = max(rights, _bearing(mount, to_right, near))
        if left - right >= 0.5 * (to_left - to_right):
            return Field(right, left, near, farthest)
    return NOWHERE


def _bearing(mount: Pose, direction: float, away: float) -> float:
    """From the robot, of what is `away` from it and in a direction from the camera, near which."""
    x, y, _ = mount
    along = x * math.cos(direction) + y * math.sin(direction)
    reach = -along + math.sqrt(along**2 - x**2 - y**2 + away**2)
    seen = math.atan2(y + reach * math.sin(direction), x + reach * math.cos(direction))
    return direction + math.remainder(seen - direction, 2 * math.pi)
