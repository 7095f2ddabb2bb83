"""Conversions between planar poses and ROS messages."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.planar import poses
from cairn.schemas.builtin_interfaces import Duration
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    Transform,
    TransformStamped,
    Twist,
    Vector3,
)
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]

# Positions of x, y and yaw in a message's row-major 6 x 6 covariance.
_PLANAR = (6 * np.array([0, 1, 5])[:, None] + np.array([0, 1, 5])).ravel()


def pose_message(pose: poses.Pose) -> Pose:
    """Return a planar pose as a message."""
    x, y, theta = pose
    return Pose(position=Point(x=x, y=y), orientation=_rotation(theta))


_NORM_TOLERANCE: Final = 1e-6  # of a quaternion: more than its rounding
_LEAST: Final = float(np.finfo(np.float64).tiny)  # so that nothing is divided by 0


def has_orientation(rotation: Quaternion) -> bool:
    """Return whether a quaternion is not all zeros, by which ROS nodes say that it is not set."""
    return bool(rotation.x or rotation.y or rotation.z or rotation.w)


def planar_pose(pose: Pose) -> poses.Pose:
    """Return x [m], y [m] and yaw [rad] of a message.

    The length of the quaternion does not matter; the yaw is 0 if it is not set (all zeros).
    """
    q = pose.orientation
    w, x, y, z = q.w, q.x, q.y, q.z
    length = math.hypot(w, x, y, z)
    if abs(length - 1.0) > _NORM_TOLERANCE and length:
        # Twice, because of numbers so large or small that their length overflows or is inexact.
        largest = max(abs(w), abs(x), abs(y), abs(z))
        w, x, y, z = w / largest, x / largest, y / largest, z / largest
        length = math.hypot(w, x, y, z)
        w, x, y, z = w / length, x / length, y / length, z / length
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return pose.position.x, pose.position.y, yaw


_LONGEST_NAME: Final = 100  # in errors and logs


class WrongFrame(CairnError):
    """A pose is in another frame than map."""


def pose_in_map(pose: PoseStamped, name: str) -> poses.Pose:
    """Return x [m], y [m] and yaw [rad] of a pose in frame map; a pose without a frame is in map.

    Raises `WrongFrame`, with the `name` of the pose, if it is in another frame.
    """
    frame = pose.header.frame_id.removeprefix("/")
    if frame not in ("", "map"):
        raise WrongFrame(f"{name} is in frame {frame[:_LONGEST_NAME]}, not map")
    return planar_pose(pose.pose)


def duration_message(seconds: float) -> Duration:
    """Return a time [s] as a message, at most the longest one (68 years)."""
    sec, nanosec = divmod(round(min(seconds, 2.0**31 - 1) * 1e9), 10**9)
    return Duration(sec=sec, nanosec=nanosec)


def twist_message(forward: float, turn: float) -> Twist:
    """Return a velocity in the plane [m/s], [rad/s]."""
    return Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))


def transform_message(header: Header, child_frame: str, pose: poses.Pose) -> TransformStamped:
    """Return the transform of a frame that is at `pose` in the header's frame."""
    x, y, theta = pose
    transform = Transform(translation=Vector3(x=x, y=y), rotation=_rotation(theta))
    return TransformStamped(header=header, child_frame_id=child_frame, transform=transform)


def with_covariance(pose: poses.Pose, covariance: Array) -> PoseWithCovariance:
    """Return a planar pose and its covariance (3, 3) over x, y, yaw as a message."""
    full = np.zeros(36)
    full[_PLANAR] = 0.5 * (covariance + covariance.T).ravel()
    return PoseWithCovariance(pose=pose_message(pose), covariance=full)


def planar_covariance(pose: PoseWithCovariance) -> Array:
    """Return the covariance (3, 3) over x, y, yaw of a message."""
    covariance: Array = pose.covariance[_PLANAR].reshape(3, 3)
    return covariance


def is_covariance(covariance: Array) -> bool:
    """Return whether a matrix (n, n) is symmetric, finite and positive semidefinite."""
    if not np.isfinite(covariance).all() or not np.allclose(covariance, covariance.T):
        return False
    variances = np.linalg.eigvalsh(covariance)
    return bool(variances[0] >= -1e-9 * max(1.0, variances[-1]))


def packed_poses(rows: Array) -> Packed[Pose]:
    """Return planar poses (n, 3) as a sequence of messages."""
    packed = np.zeros((rows.shape[0], 7))
    packed[:, 0], packed[:, 1] = rows[:, 0], rows[:, 1]
    packed[:, 5], packed[:, 6] = np.sin(rows[:, 2] / 2), np.cos(rows[:, 2] / 2)
    return Packed(Pose, packed)


def planar_poses(packed: Packed[Pose]) -> Array:
    """Return the planar poses (n, 3) of a sequence of messages."""
    rows = np.empty((len(packed), 3))
    rows[:, 0], rows[:, 1] = packed.array[:, 0], packed.array[:, 1]
    quaternions = packed.array[:, 3:]
    with np.errstate(over="ignore"):
        unit = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) <= _NORM_TOLERANCE
    if not unit.all():
        others = quaternions[~unit]
        others = others / np.maximum(np.abs(others).max(axis=1, keepdims=True), _LEAST)
        quaternions = quaternions.copy()
        quaternions[~unit] = others / np.maximum(
            np.linalg.norm(others, axis=1, keepdims=True), _LEAST
        )
    x, y, z, w = quaternions.T
    rows[:, 2] = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return rows


def _rotation(theta: float) -> Quaternion:
    return Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
