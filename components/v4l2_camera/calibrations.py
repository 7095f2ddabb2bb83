"""What is told of cameras that are calibrated, and of those that are not."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from cairn.errors import CairnError
from schemas.sensor_msgs import CameraInfo
from vision.camera_file import read_camera
from vision.stereo import StereoRig


def camera_infos(
    files: Sequence[Path | None], frames: Sequence[str], size: tuple[int, int], log: logging.Logger
) -> tuple[list[CameraInfo], float | None]:
    """What is told of each camera, and their baseline [m] if two are calibrated together.

    `size` [px] is that of their pictures. Without a file that alone is told, as ROS has it, and
    that nothing can be ranged is logged. Raises `CairnError` for a file that cannot be used or is
    of pictures of another size.
    """
    width, height = size
    infos = []
    for file, frame in zip(files, frames, strict=True):
        info = CameraInfo(width=width, height=height)
        if file is None:
            log.warning("%s: no calibration is given, so nothing can be ranged", frame)
        else:
            info = read_camera(file, frame)
        if (info.width, info.height) != size:
            raise CairnError(
                f"{file} is of images of {info.width} x {info.height} pixels, but the camera gives "
                f"{width} x {height}: calibrate with such images, or ask for others by width and "
                "height"
            )
        infos.append(info)
    if len(infos) == 2 and all(files):
        return infos, StereoRig.of(*infos).baseline
    return infos, None
