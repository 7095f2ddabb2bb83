"""Planar poses as messages."""

from __future__ import annotations

import math

from schemas.geometry_msgs import Point, Pose, Quaternion


def planar_pose(x: float, y: float, theta: float) -> Pose:
    """The pose at x, y [m], turned left by theta [rad]."""
    return Pose(
        position=Point(x=x, y=y),
        orientation=Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2)),
    )
