"""Messages to and from a base that speaks ROS 2."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cairn import from_ns
from cairn.planar.messages import pose_message, transform_message
from cairn.planar.poses import Pose
from cairn.schemas.geometry_msgs import (
    PoseWithCovariance,
    TransformStamped,
    Twist,
    TwistStamped,
    Vector3,
)
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]

ODOM, BASE = "odom", "base_link"  # frames of Cairn's robots


def twist(forward: float, turn: float) -> Twist:
    """A command [m/s, rad/s]."""
    return Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))


def stamped_twist(stamp: int, frame: str, forward: float, turn: float) -> TwistStamped:
    """A command of a time [ns] in the base's own frame; 0 is taken for the base's present."""
    return TwistStamped(
        header=Header(stamp=from_ns(stamp), frame_id=frame), twist=twist(forward, turn)
    )


def odometry(message: Odometry, stamp: int, pose: Pose, turned: float) -> Odometry:
    """The base's odometry in the robot's frames, and on the plane.

    `turned`: how far `pose`, and so the axes of its covariance, are turned against the base's own
    [rad].
    """
    covariance = turned_covariance(message.pose.covariance, turned)
    return dataclasses.replace(
        message,
        header=Header(stamp=from_ns(stamp), frame_id=ODOM),
        child_frame_id=BASE,
        pose=PoseWithCovariance(pose=pose_message(pose), covariance=covariance),
    )


def turned_covariance(covariance: Array, angle: float) -> Array:
    """A row-major 6 x 6 covariance of a pose, whose frame is turned by an angle [rad] about z."""
    if not angle:
        return covariance
    cosine, sine = np.cos(angle), np.sin(angle)
    about_z = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    turn = np.kron(np.eye(2), about_z)
    turned: Array = (turn @ covariance.reshape(6, 6) @ turn.T).ravel()
    return turned


def transform(message: Odometry, pose: Pose) -> TransformStamped:
    """The same pose as a transform."""
    return transform_message(message.header, BASE, pose)
