"""What is told of cameras that are calibrated, and how far apart two of them sit."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from cairn.schemas.sensor_msgs import CameraInfo
from cairn.vision.camera_file import read_camera
from cairn.vision.stereo import StereoRig


def read_calibrations(
    files: Sequence[Path | None], frames: Sequence[str], log: logging.Logger
) -> tuple[list[CameraInfo | None], float | None]:
    """What is told of each camera, and their baseline [m] if two are calibrated together.

    Without a file that is None, and that nothing can be ranged is logged. Raises `CairnError` for a
    file that cannot be used.
    """
    infos = [
        None if file is None else read_camera(file, frame)
        for file, frame in zip(files, frames, strict=True)
    ]
    known = [info for info in infos if info is not None]
    for frame, info in zip(frames, infos, strict=True):
        if info is None:
            log.warning("%s: no calibration is given, so nothing can be ranged", frame)
    if len(known) == 2:
        return infos, StereoRig.of(*known).baseline
    return infos, None
