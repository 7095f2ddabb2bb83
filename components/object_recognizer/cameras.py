"""The recognizer's cameras: their calibration, pairs of images, and images that show nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND, CairnError
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.vision.features import Features
from cairn.vision.images import gray_of
from cairn.vision.rectification import CameraModel, Rectifier
from cairn.vision.stereo import StereoRig, are_swapped, disparities

Gray = NDArray[np.uint8]

PATIENCE_NS: Final = SECOND
"""How long left images wait for right ones before they are used alone."""

# Nearly all pixels of an image in the dark, or of a lamp, are below, or above, these gray levels.
_DARK, _BRIGHT = 40, 215
_NEARLY_ALL: Final = 95.0  # [%]
# An image with fewer features shows next to nothing, with or without an object.
_FEW_FEATURES = 25
# Points of the left image that are searched in the right one, and the least share of them that is
# found if both are of one pair: the others are at its edges, or covered.
_PROBES, _FEW_FOUND = 100, 0.2


@dataclass(frozen=True)
class Cameras:
    """How images are rectified, and the geometry of rectified images.

    Without a `right` camera, `rig` has no baseline and is that of the left one. `pair_error` is
    the reason if a calibration of the right camera exists but is not used.
    """

    left: Rectifier
    right: Rectifier | None
    rig: StereoRig
    pair_error: str = ""


def make_cameras(left: CameraInfo, right: CameraInfo | None) -> Cameras:
    """Return the stereo pair, or the left camera alone if the right one does not match it.

    Raises `CairnError` if the left camera is not calibrated, or if the two are swapped: then the
    position of neither camera is known.
    """
    rectifier = Rectifier(left)
    if right is None:
        return Cameras(rectifier, None, _single(left))
    try:
        return Cameras(rectifier, Rectifier(right), StereoRig.of(left, right))
    except CairnError as error:
        if _is_pair(right, left):
            raise
        return Cameras(rectifier, None, _single(left), str(error))


class CameraCalibration:
    """The newest CameraInfo of each camera, and what follows from them."""

    def __init__(self) -> None:
        self._infos: dict[str, CameraInfo | None] = {"left": None, "right": None}
        self._cameras: Cameras | None = None

    def store(self, side: str, info: CameraInfo) -> None:
        """Store the CameraInfo of the `left` or `right` camera."""
        if not is_same_calibration(info, self._infos[side]):
            self._infos[side] = info
            self._cameras = None

    def cameras(self, topic: str, *, stereo: bool) -> Cameras:
        """Return the calibrated cameras: the left one alone, unless `stereo`.

        Raises `CairnError` if no CameraInfo has arrived on `topic`, that of the left camera, or as
        `make_cameras`.
        """
        if self._cameras is None:
            left, right = self._infos["left"], self._infos["right"]
            if left is None:
                raise CairnError(
                    f"no CameraInfo has arrived on {topic}; have the camera's driver publish it"
                )
            self._cameras = make_cameras(left, right if stereo else None)
        return self._cameras


def is_same_calibration(one: CameraInfo | None, other: CameraInfo | None) -> bool:
    """Return whether two CameraInfos are equal except for their stamps."""
    if one is None or other is None:
        return one is other
    return _content(one) == _content(other)


def gray_image(image: Image, topic: str) -> Gray:
    """Return an image of a topic as gray levels; `CairnError` names the topic."""
    try:
        return gray_of(image)
    except CairnError as error:
        raise CairnError(f"{topic}: {error}") from error


def why_blind(gray: Gray) -> str:
    """Return why the camera sees nothing, "" if it does."""
    sample = gray[::4, ::4]
    if np.percentile(sample, _NEARLY_ALL) < _DARK:
        return "it is too dark"
    if np.percentile(sample, 100 - _NEARLY_ALL) > _BRIGHT:
        return "it is too bright"
    return ""


def shows_little(features: Features) -> bool:
    """Return whether an image shows hardly anything: a blank wall, or a covered lens."""
    return len(features) < _FEW_FEATURES


def cameras_are_swapped(left: Gray, right: Gray, features: Features, rig: StereoRig) -> bool:
    """Return whether the rectified `left` image with these features is the right camera's."""
    return are_swapped(left, right, features.points[:_PROBES], rig)


def why_no_pair(left: Gray, right: Gray, features: Features, rig: StereoRig) -> str:
    """Return why rectified images are not a pair of one moment, "" if they may be one."""
    points = features.points[:_PROBES]
    most = rig.nearest_disparity(0.3)
    found = np.isfinite(disparities(left, right, points, rig, least=-most, most=most))
    if np.count_nonzero(found) > _FEW_FOUND * len(points):
        return ""
    blind = why_blind(right)
    if blind:
        return f"the right image shows next to nothing ({blind})"
    return (
        "hardly anything of the left image is found in the right one; check that both are of one "
        "moment, and of the cameras that were calibrated together"
    )


class FrozenImageDetector:
    """Detects a camera that sends the same image again: noise makes no two images equal."""

    def __init__(self) -> None:
        self._last: Image | None = None
        self._since_ns = 0
        self.frozen = False
        """Whether the newest image equals the one before."""

    def frozen_for_ns(self, image: Image, now_ns: int) -> int | None:
        """Return for how long the image has been the same, bit for bit; None if it is new."""
        last, self._last = self._last, image
        self.frozen = same = (
            last is not None
            and (last.width, last.height, last.encoding)
            == (image.width, image.height, image.encoding)
            and np.array_equal(last.data, image.data)
        )
        if not same or now_ns < self._since_ns:
            self._since_ns = now_ns
        return now_ns - self._since_ns if same else None


@dataclass(frozen=True)
class StereoImages:
    """A left image, and the right one that was taken at the same time, if it exists."""

    stamp_ns: int
    left: Image
    right: Image | None


class StereoSynchronizer:
    """Pairs left and right images of the same stamp; keeps only the newest of each side."""

    def __init__(self, *, stereo: bool) -> None:
        self._stereo = stereo
        self._left: tuple[int, Image] | None = None
        self._right: tuple[int, Image] | None = None
        self._used_alone: int | None = None
        self._waiting_since: int | None = None

    def right_is_missing(self, now_ns: int) -> bool:
        """Return whether left images are used alone because right ones no longer arrive."""
        since = self._waiting_since
        return self._stereo and since is not None and now_ns - since > PATIENCE_NS

    def add_left(self, stamp_ns: int, image: Image, now_ns: int) -> StereoImages | None:
        """Add a left image; return what can be processed now."""
        self._left = (stamp_ns, image)
        pair = self._pair()
        if pair is not None:
            return pair
        if self._waiting_since is None or now_ns < self._waiting_since:  # the clock may jump back
            self._waiting_since = now_ns
        if self._stereo and not self.right_is_missing(now_ns):
            return None
        self._left, self._used_alone = None, stamp_ns
        return StereoImages(stamp_ns, image, None)

    def add_right(self, stamp_ns: int, image: Image) -> StereoImages | None:
        """Add a right image; return what can be processed now."""
        self._right = (stamp_ns, image)
        if stamp_ns == self._used_alone:
            self._waiting_since = None  # right images arrive again
        return self._pair()

    def _pair(self) -> StereoImages | None:
        left, right = self._left, self._right
        if left is None or right is None or left[0] != right[0]:
            return None
        self._left = self._right = self._waiting_since = None
        return StereoImages(left[0], left[1], right[1])


def _single(info: CameraInfo) -> StereoRig:
    p = CameraModel.of(info).projection
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
