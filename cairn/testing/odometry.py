"""Judges odometry: units, signs, and whether pose, twist and transform tell the same.

All raise `AssertionError` with a sentence that names the fault. Lengths are in meters, angles in
radians, times in seconds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cairn.clock import to_ns
from cairn.schemas.geometry_msgs import Quaternion
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.tf2_msgs import TFMessage

_UNIT = 1e-3  # by which a quaternion's length may be off
_WAY_M = 0.02  # by which ways may differ, whatever their length: encoders have steps
_TURN_RAD = 0.05


@dataclass(frozen=True)
class Traveled:
    """What a piece of odometry adds up to: by its poses, and by its twists over time."""

    ahead_m: float
    ahead_by_twist_m: float
    left_rad: float
    left_by_twist_rad: float
    longest_speed: float
    """The greatest speed that a twist tells [m/s]."""


def traveled(odoms: Sequence[Odometry]) -> Traveled:
    """Add up the way ahead (along the heading; negative backwards) and the turn to the left."""
    ahead = left = ahead_by_twist = left_by_twist = 0.0
    for before, after in pairwise(odoms):
        seconds = (to_ns(after.header.stamp) - to_ns(before.header.stamp)) / 1e9
        turn = _wrapped(_heading(after) - _heading(before))
        middle = _heading(before) + 0.5 * turn
        step = [
            after.pose.pose.position.x - before.pose.pose.position.x,
            after.pose.pose.position.y - before.pose.pose.position.y,
        ]
        ahead += step[0] * math.cos(middle) + step[1] * math.sin(middle)
        left += turn
        twist = after.twist.twist
        ahead_by_twist += seconds * twist.linear.x
        left_by_twist += seconds * twist.angular.z
    fastest = max((abs(odom.twist.twist.linear.x) for odom in odoms), default=0.0)
    return Traveled(ahead, ahead_by_twist, left, left_by_twist, fastest)


def check_frames(odom: Odometry, frame: str, child: str) -> None:
    """The pose is of the robot in its odometry's frame, the twist in the robot's own."""
    found = (odom.header.frame_id, odom.child_frame_id)
    assert found == (frame, child), (
        f"odometry is of {found[1]!r} in {found[0]!r}, but should be of {child!r} in {frame!r}"
    )


def check_pose(odom: Odometry) -> None:
    """An orientation of unit length about the z axis, on the plane."""
    rotation = odom.pose.pose.orientation
    length = _length(rotation)
    assert abs(length - 1.0) <= _UNIT, (
        f"the orientation's quaternion has length {length:g}, not 1: it is no rotation"
    )
    tilt = math.hypot(rotation.x, rotation.y)
    assert tilt <= _UNIT, (
        f"the orientation {rotation} is tilted: a base on the plane turns about z alone; is its "
        "order x, y, z, w?"
    )
    z = odom.pose.pose.position.z
    assert abs(z) <= 1e-6, f"the base is at z = {z:g} m: odometry is on the plane"


def check_covariance(odom: Odometry) -> None:
    """Symmetric, and no variance negative."""
    for name, values in (("pose", odom.pose.covariance), ("twist", odom.twist.covariance)):
        matrix = np.asarray(values).reshape(6, 6)
        assert np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12), (
            f"the covariance of the {name} is not symmetric: {matrix.tolist()}"
        )
        assert (matrix.diagonal() >= 0.0).all(), (
            f"the covariance of the {name} has a negative variance: {matrix.diagonal().tolist()}"
        )


def check_twist_agrees(odoms: Sequence[Odometry], tolerance: float) -> None:
    """What the twists add up to over time is what the poses say, within a share."""
    way = traveled(odoms)
    _agree(
        way.ahead_m, way.ahead_by_twist_m, tolerance, _WAY_M, "m ahead", "m/s (and in base_link)"
    )
    _agree(way.left_rad, way.left_by_twist_rad, tolerance, _TURN_RAD, "rad to the left", "rad/s")


def check_transforms_agree(
    odoms: Sequence[Odometry], transforms: Sequence[TFMessage], frame: str, child: str
) -> None:
    """For each stamp that both have, tf says the same as odometry."""
    poses = {to_ns(odom.header.stamp): odom.pose.pose for odom in odoms}
    compared = 0
    for message in transforms:
        for there in message.transforms:
            pose = poses.get(to_ns(there.header.stamp))
            if (there.header.frame_id, there.child_frame_id) != (frame, child) or pose is None:
                continue
            compared += 1
            move, turn = there.transform.translation, there.transform.rotation
            off_m = math.dist((move.x, move.y), (pose.position.x, pose.position.y))
            off_rad = abs(_wrapped(_yaw(turn) - _yaw(pose.orientation)))
            assert off_m <= 1e-6, f"tf puts {child} {off_m:g} m off where odometry has it"
            assert off_rad <= 1e-6, f"tf turns {child} {off_rad:g} rad off what odometry says"
    assert compared, (
        f"of {len(transforms)} messages on tf none tells {frame} to {child} at a stamp of odometry"
    )


def is_still(odom: Odometry, speed: float, turn: float) -> bool:
    """Whether its twist is no faster than that [m/s, rad/s]."""
    twist = odom.twist.twist
    return abs(twist.linear.x) <= speed and abs(twist.angular.z) <= turn


def _agree(pose: float, twist: float, tolerance: float, least: float, what: str, unit: str) -> None:
    assert abs(pose - twist) <= max(least, tolerance * abs(pose)), (
        f"by its poses the base went {pose:.3f} {what}, by its twists {twist:.3f}: a twist is the "
        f"speed in {unit}"
    )


def _heading(odom: Odometry) -> float:
    return _yaw(odom.pose.pose.orientation)


def _yaw(rotation: Quaternion) -> float:
    return 2.0 * math.atan2(rotation.z, rotation.w)


def _length(rotation: Quaternion) -> float:
    return math.hypot(rotation.x, rotation.y, rotation.z, rotation.w)


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
