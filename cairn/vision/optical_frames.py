"""The frames of a stereo camera's images."""

from __future__ import annotations

from typing import Final

from cairn.schemas.geometry_msgs import Quaternion, Transform, TransformStamped, Vector3
from cairn.schemas.std_msgs import Header

LEFT_FRAME: Final = "left_camera_optical_frame"
"""Frame of the left camera's images, or of those of the only one: x right, y down, z ahead."""
RIGHT_FRAME: Final = "right_camera_optical_frame"
"""Frame of the right camera's images."""

_LOOKING_AHEAD = Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5)  # z along the mount's x axis: REP 103


def optical_transform(header: Header, frame: str, baseline: float) -> TransformStamped:
    """Return the transform of an optical frame, `baseline` [m] to the right of the left camera.

    The header's frame is that on which the left camera is mounted, looking along its x axis.
    """
    translation = Vector3(y=-baseline)
    transform = Transform(translation=translation, rotation=_LOOKING_AHEAD)
    return TransformStamped(header=header, child_frame_id=frame, transform=transform)
