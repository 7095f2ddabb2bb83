"""Where a camera's optical frame is on the robot."""

from __future__ import annotations

import math

from cairn import Mount
from cairn.schemas.geometry_msgs import Quaternion, Transform, TransformStamped, Vector3
from cairn.schemas.std_msgs import Header


def placed(
    header: Header, frame: str, mount: Mount, height: float, baseline: float
) -> TransformStamped:
    """The frame of a level camera, `baseline` [m] to the right of where the left one is mounted.

    Its x is to the right, y down and z ahead (REP 103); `height` is above the floor [m].
    """
    x, y, theta = mount.pose
    sine, cosine = math.sin(theta), math.cos(theta)
    half_sine, half_cosine = math.sin(0.5 * theta), math.cos(0.5 * theta)
    more, less = 0.5 * (half_cosine + half_sine), 0.5 * (half_cosine - half_sine)
    return TransformStamped(
        header=header,
        child_frame_id=frame,
        transform=Transform(
            translation=Vector3(x=x + baseline * sine, y=y - baseline * cosine, z=height),
            rotation=Quaternion(x=-more, y=less, z=-less, w=more),
        ),
    )
