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


def optical_transforms(header: Header, baseline: float | None) -> tuple[TransformStamped, ...]:
    """Return the transforms of both optical frames, the right one `baseline` [m] to the right.

    The header's frame is that on which the left camera is mounted, looking along its x axis.
    Without a baseline there is only the left one.
    """
    offsets = {LEFT_FRAME: 0.0} if baseline is None else {LEFT_FRAME: 0.0, RIGHT_FRAME: baseline}
    return tuple(
        TransformStamped(
            header=header,
            child_frame_id=frame,
            transform=Transform(translation=Vector3(y=-offset), rotation=_LOOKING_AHEAD),
        )
        for frame, offset in offsets.items()
    )
