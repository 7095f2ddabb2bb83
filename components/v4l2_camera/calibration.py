"""Calibrations of the cameras, and the transforms of their optical frames."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from pathlib import Path

from cairn import Mount
from cairn.schemas.geometry_msgs import Quaternion, Transform, TransformStamped, Vector3
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.schemas.std_msgs import Header
from cairn.vision.camera_file import read_camera
from cairn.vision.stereo import StereoRig


def read_calibrations(
    files: Sequence[Path | None], frames: Sequence[str], log: logging.Logger
) -> tuple[list[CameraInfo | None], float | None]:
    """Read the calibration of each camera, and the baseline [m] of two that are calibrated.

    Without a file the calibration is None, and a warning is logged, as no range can be measured.
    Raises `CairnError` for a file that cannot be used.
    """
    infos = [
        None if file is None else read_camera(file, frame)
        for file, frame in zip(files, frames, strict=True)
    ]
    known = [info for info in infos if info is not None]
    for frame, info in zip(frames, infos, strict=True):
        if info is None:
            log.warning("%s has no calibration, so no ranges can be measured", frame)
    if len(known) == 2:
        return infos, StereoRig.of(*known).baseline
    return infos, None


def optical_frame_transform(
    header: Header, frame: str, mount: Mount, height: float, baseline: float
) -> TransformStamped:
    """Return the optical frame of a level camera, `baseline` [m] to the right of the left one.

    Its x axis points right, y down and z forward (REP 103); `mount` is that of the left camera,
    `height` is above the floor [m].
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
