"""Judges the images of a stereo camera: sizes, encodings, calibrations, and what belongs together.

All raise `AssertionError` with a sentence that names the fault. Lengths are in meters and pixels.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cairn.clock import to_ns
from cairn.schemas.sensor_msgs import CameraInfo, Image

BYTES_PER_PIXEL: Mapping[str, int] = {
    "mono8": 1,
    "mono16": 2,
    "rgb8": 3,
    "bgr8": 3,
    "rgba8": 4,
    "bgra8": 4,
    "yuv422": 2,
    "yuv422_yuy2": 2,
    "bayer_rggb8": 1,
    "bayer_bggr8": 1,
    "bayer_gbrg8": 1,
    "bayer_grbg8": 1,
}
"""Encodings of sensor_msgs/Image that cameras send."""

_LONGEST_BASELINE_M = 2.0
_CHECKSUM_BYTES = 4


def outline(image: Image) -> Image:
    """The image with a check sum in place of its pixels: many of a stream can be kept so.

    It is one row, as high and long as the check sum is; the rest is as it was.
    """
    return replace(
        image,
        height=1,
        step=_CHECKSUM_BYTES,
        data=np.frombuffer(zlib.crc32(image.data.tobytes()).to_bytes(_CHECKSUM_BYTES), np.uint8),
    )


def check_image(image: Image) -> None:
    """Its encoding is known, and a row holds its pixels."""
    assert image.width > 0, f"an image is {image.width} x {image.height} pixels"
    assert image.height > 0, f"an image is {image.width} x {image.height} pixels"
    bytes_ = BYTES_PER_PIXEL.get(image.encoding)
    assert bytes_ is not None, (
        f"encoding {image.encoding!r} is none of {', '.join(BYTES_PER_PIXEL)}"
    )
    assert image.step >= image.width * bytes_, (
        f"step = {image.step} bytes, but a row of {image.width} pixels in {image.encoding} has "
        f"{image.width * bytes_}"
    )


def check_size(image: Image, info: CameraInfo, side: str) -> None:
    """The image is of the size that its calibration is for."""
    found, told = (image.width, image.height), (info.width, info.height)
    hint = ": width and height are swapped" if found == told[::-1] else ""
    assert found == told, (
        f"the {side} image is {found[0]} x {found[1]} pixels, but its camera info says "
        f"{told[0]} x {told[1]}{hint}"
    )


def check_calibration(info: CameraInfo, side: str) -> None:
    """Focal lengths and center are those of a camera of this size [px]."""
    fx, fy, cx, cy = info.k[0], info.k[4], info.k[2], info.k[5]
    assert min(fx, fy) > 0.0, f"the {side} camera has the focal lengths {fx:g}, {fy:g} px"
    assert 0.0 < cx < info.width, (
        f"the {side} camera's center is at {cx:g}, {cy:g} px, outside of the image"
    )
    assert 0.0 < cy < info.height, (
        f"the {side} camera's center is at {cx:g}, {cy:g} px, outside of the image"
    )


def check_baseline(left: CameraInfo, right: CameraInfo) -> None:
    """The right camera is on the right: its p has -fx * baseline, the left one's has 0."""
    assert left.p[3] == 0.0, (
        f"p of the left camera has Tx = {left.p[3]:g}, not 0: are the sides swapped?"
    )
    baseline = -right.p[3] / right.p[0] if right.p[0] else math.nan
    assert 0.0 < baseline < _LONGEST_BASELINE_M, (
        f"by p of the right camera it is {baseline:g} m to the right of the left one (at most "
        f"{_LONGEST_BASELINE_M:g} m): Tx is -fx * baseline in meters"
    )


def is_calibrated(info: CameraInfo) -> bool:
    """Whether the camera is; `k` is 0 if not."""
    return bool(info.k[0])


def check_together(streams: Mapping[str, Sequence[Image | CameraInfo]]) -> None:
    """Each stamp of one stream is in all others, but for what came at the edges of the sample."""
    stamps = {name: [to_ns(one.header.stamp) for one in some] for name, some in streams.items()}
    first = max(min(some) for some in stamps.values())
    last = min(max(some) for some in stamps.values())
    for name, some in stamps.items():
        within = {stamp for stamp in some if first <= stamp <= last}
        for other, others in stamps.items():
            alone = within - set(others)
            assert not alone, (
                f"{len(alone)} of {len(within)} messages on {name} have a stamp that none on "
                f"{other} has, such as {min(alone)} ns: the messages of a pair have the same stamp"
            )


def check_not_frozen(images: Sequence[Image], side: str) -> None:
    """Images differ: no camera takes the same one twice, bit by bit."""
    sums = {image.data.tobytes() for image in images}
    assert len(sums) > 1, f"all {len(images)} {side} images are the same, bit by bit"
