"""The camera, or the stereo pair, that is looked with: what its CameraInfos say of it."""

from __future__ import annotations

from dataclasses import dataclass

from cairn import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.vision.rectification import Lens, Rectifier
from cairn.vision.stereo import StereoRig


@dataclass(frozen=True)
class Cameras:
    """How images are rectified, and the geometry of what comes of it.

    Without a `right` camera `rig` has no baseline and is that of the left one. `complaint` says
    why there is none although one was given.
    """

    left: Rectifier
    right: Rectifier | None
    rig: StereoRig
    complaint: str = ""


def cameras_of(left: CameraInfo, right: CameraInfo | None) -> Cameras:
    """What can be looked with: the pair, or where the right camera does not fit, the left alone.

    Raises `CairnError` if the left camera is not calibrated, or if the two are swapped: then it is
    not known where either of them is.
    """
    rectifier = Rectifier(left)
    if right is None:
        return Cameras(rectifier, None, _alone(left))
    try:
        return Cameras(rectifier, Rectifier(right), StereoRig.of(left, right))
    except CairnError as error:
        if _is_pair(right, left):
            raise
        return Cameras(rectifier, None, _alone(left), str(error))


def same_camera(one: CameraInfo | None, other: CameraInfo | None) -> bool:
    """Whether two CameraInfos tell the same, but for their stamps."""
    if one is None or other is None:
        return one is other
    return _content(one) == _content(other)


def _alone(info: CameraInfo) -> StereoRig:
    p = Lens.of(info).projection
    fx, fy, cx, cy = (float(value) for value in (p[0, 0], p[1, 1], p[0, 2], p[1, 2]))
    return StereoRig(fx, fy, cx, cy, 0.0, info.width, info.height)


def _is_pair(left: CameraInfo, right: CameraInfo) -> bool:
    try:
        StereoRig.of(left, right)
    except CairnError:
        return False
    return True


def _content(info: CameraInfo) -> tuple[object, ...]:
    arrays = (info.d, info.k, info.r, info.p)
    size = (info.width, info.height, info.binning_x, info.binning_y)
    return (*size, info.distortion_model, info.roi, *(array.tobytes() for array in arrays))
