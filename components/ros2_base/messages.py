"""Messages to and from a base that speaks ROS 2."""

from __future__ import annotations

import dataclasses

from cairn.clock import from_ns
from planar.messages import pose_message, transform_message
from planar.poses import Pose
from schemas.geometry_msgs import TransformStamped, Twist, TwistStamped, Vector3
from schemas.nav_msgs import Odometry
from schemas.std_msgs import Header

ODOM, BASE = "odom", "base_link"  # frames of Cairn's robots


def twist(forward: float, turn: float) -> Twist:
    """A command [m/s, rad/s]."""
    return Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))


def stamped_twist(now: int, forward: float, turn: float) -> TwistStamped:
    """A command of the time `now` [ns]."""
    return TwistStamped(
        header=Header(stamp=from_ns(now), frame_id=BASE), twist=twist(forward, turn)
    )


def odometry(message: Odometry, stamp: int, pose: Pose, *, moved: bool) -> Odometry:
    """The base's odometry in the robot's frames; `moved`: at another pose than it said."""
    given = message.pose
    if moved:
        given = dataclasses.replace(given, pose=pose_message(pose))
    return dataclasses.replace(
        message,
        header=Header(stamp=from_ns(stamp), frame_id=ODOM),
        child_frame_id=BASE,
        pose=given,
    )


def transform(message: Odometry, pose: Pose) -> TransformStamped:
    """The same pose as a transform."""
    return transform_message(message.header, BASE, pose)
