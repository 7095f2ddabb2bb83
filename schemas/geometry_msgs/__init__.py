"""ROS 2 package geometry_msgs: points, poses, velocities and transforms (REP 103: m, rad, s)."""

from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from cairn.schemas.field_types import (
    Array,
    FiniteFloat32,
    FiniteFloat64,
    String,
    finite,
    zeros,
)
from cairn.schemas.message import message
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header

Covariance6 = Annotated[npt.NDArray[np.float64], Array("float64", length=36, check=finite)]
"""Covariance, row-major 6x6 over x, y, z and rotations about X, Y, Z; only checked to be finite."""


@message("geometry_msgs/msg/Point")
class Point:
    """A position [m]."""

    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    z: FiniteFloat64 = 0.0


@message("geometry_msgs/msg/Point32")
class Point32:
    """A position [m] in single precision."""

    x: FiniteFloat32 = 0.0
    y: FiniteFloat32 = 0.0
    z: FiniteFloat32 = 0.0


@message("geometry_msgs/msg/Polygon")
class Polygon:
    """The corners of a polygon, in order."""

    points: tuple[Point32, ...] = ()


@message("geometry_msgs/msg/PolygonStamped")
class PolygonStamped:
    """A polygon with its frame and time, such as the footprint of a robot."""

    header: Header = Header()
    polygon: Polygon = Polygon()


@message("geometry_msgs/msg/Vector3")
class Vector3:
    """A direction, a velocity [m/s] or [rad/s], or a translation [m]."""

    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    z: FiniteFloat64 = 0.0


@message("geometry_msgs/msg/Quaternion")
class Quaternion:
    """An orientation. The length is not checked, because ROS nodes send all zeros for "not set"."""

    x: FiniteFloat64 = 0.0
    y: FiniteFloat64 = 0.0
    z: FiniteFloat64 = 0.0
    w: FiniteFloat64 = 1.0


@message("geometry_msgs/msg/Pose")
class Pose:
    """A position and an orientation."""

    position: Point = Point()
    orientation: Quaternion = Quaternion()


@message("geometry_msgs/msg/PoseStamped")
class PoseStamped:
    """A pose with its frame and time."""

    header: Header = Header()
    pose: Pose = Pose()


def _repair_covariance(values: dict[str, Any]) -> list[str]:
    """Repair a covariance: what is not known is 0, as ROS nodes send it."""
    covariance = values["covariance"]
    known = np.isfinite(covariance)
    if known.all():
        return []
    # Without one of the variances in the plane, the others mean nothing to a robot on wheels.
    values["covariance"] = np.where(known & known[[0, 7, 35]].all(), covariance, 0.0)
    return ["numbers in covariance that are not finite: 0, not known"]


@message("geometry_msgs/msg/PoseWithCovariance", repair=_repair_covariance)
class PoseWithCovariance:
    """A pose with its uncertainty."""

    pose: Pose = Pose()
    covariance: Covariance6 = zeros(36)


@message("geometry_msgs/msg/PoseWithCovarianceStamped")
class PoseWithCovarianceStamped:
    """An uncertain pose with its frame and time."""

    header: Header = Header()
    pose: PoseWithCovariance = PoseWithCovariance()


@message("geometry_msgs/msg/PoseArray")
class PoseArray:
    """Many poses in one frame, such as the particles of a filter; `poses.array` is (n, 7)."""

    header: Header = Header()
    poses: Packed[Pose] = Packed(Pose)


@message("geometry_msgs/msg/Twist")
class Twist:
    """A velocity: linear [m/s] and angular [rad/s]."""

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


@message("geometry_msgs/msg/TwistStamped")
class TwistStamped:
    """A velocity with its frame and time."""

    header: Header = Header()
    twist: Twist = Twist()


@message("geometry_msgs/msg/TwistWithCovariance", repair=_repair_covariance)
class TwistWithCovariance:
    """A velocity with its uncertainty."""

    twist: Twist = Twist()
    covariance: Covariance6 = zeros(36)


@message("geometry_msgs/msg/Transform")
class Transform:
    """The pose of one coordinate frame in another."""

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


@message("geometry_msgs/msg/TransformStamped")
class TransformStamped:
    """The transform from frame `header.frame_id` to frame `child_frame_id` at a time."""

    header: Header = Header()
    child_frame_id: String = ""
    transform: Transform = Transform()
