"""The contract of a camera with the ports `left_image`, `right_image`, `left_info`, `right_info`.

A single camera has only the left ports. docs/how-to/vision.md describes the ports. A failed check
raises `AssertionError`, which describes the fault. Units are meters and pixels.
"""

from __future__ import annotations

import contextlib
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pytest

from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.testing import timing as timed
from cairn.testing.driver_contract import DriverContract, StampedContract
from cairn.testing.robot import Arrival, Bench, Reading, RunningDeployment
from cairn.testing.scanner_contract import check_frame
from cairn.testing.timing import undisturbed

_KINDS: Mapping[str, type[Any]] = {"image": Image, "info": CameraInfo}
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
"""Encodings of sensor_msgs/Image that cameras publish."""

_LONGEST_BASELINE_M = 2.0
_CHECKSUM_BYTES = 4


@dataclass(frozen=True)
class Pictures:
    """A sample of messages by side: images without pixels, one complete image, camera infos."""

    outlines: Mapping[str, list[Arrival[Image]]]
    whole: Mapping[str, Image]
    infos: Mapping[str, list[Arrival[CameraInfo]]]
    order: Sequence[tuple[str, int]]
    """Port and stamp [ns] of each message, in order of arrival."""


class PicturesContract(StampedContract):
    """Tests the contents and stamps of images and camera infos."""

    component: ClassVar[str] = "camera"
    port: ClassVar[str] = "left_info"
    message: ClassVar[type[Any]] = CameraInfo

    stereo: ClassVar[bool] = True
    """False for a single camera, which has only the left ports."""

    calibrated: ClassVar[bool] = True
    """False if the driver has no calibration in the deployment."""

    moving: ClassVar[bool] = True
    """False if successive images may be identical, such as those of a test picture."""

    frames: ClassVar[Mapping[str, str]] = {
        "left": "left_camera_optical_frame",
        "right": "right_camera_optical_frame",
    }
    """Optical frames of the cameras: x right, y down, z forward (REP 103)."""

    sample_count: ClassVar[int] = 12
    """Number of messages per port in a sample."""

    @classmethod
    def sides(cls) -> tuple[str, ...]:
        """Return the sides that have a camera."""
        return ("left", "right") if cls.stereo else ("left",)

    @pytest.fixture(scope="class")
    @classmethod
    def pictures(cls, bench: Bench) -> Pictures:
        """Return a sample of consecutive pairs, which the tests of the class share."""
        robot = bench.robot(cls.component)
        return undisturbed(lambda: cls._taken(robot))

    @classmethod
    def _taken(cls, robot: RunningDeployment) -> Pictures:
        whole: dict[str, Image] = {}

        def keep(side: str, image: Image) -> Image:
            whole.setdefault(side, image)
            return outline(image)

        types = {f"{side}_{kind}": type_ for side in cls.sides() for kind, type_ in _KINDS.items()}
        ports = {cls.topic(robot, port): port for port in types}
        with contextlib.ExitStack() as stack:
            images: dict[str, Reading[Image]] = {}
            infos: dict[str, Reading[CameraInfo]] = {}
            for side in cls.sides():
                topic = cls.topic(robot, f"{side}_image")
                images[side] = stack.enter_context(robot.read(topic, Image, partial(keep, side)))
                topic = cls.topic(robot, f"{side}_info")
                infos[side] = stack.enter_context(robot.read(topic, CameraInfo))
            with robot.read_in_order({topic: types[port] for topic, port in ports.items()}) as came:
                for image in images.values():
                    cls.sample(image, cls.sample_count)
                for info in infos.values():
                    cls.sample(info, cls.sample_count)
        count = cls.sample_count
        return Pictures(
            {side: reading.arrivals[:count] for side, reading in images.items()},
            whole,
            {side: reading.arrivals[:count] for side, reading in infos.items()},
            [(ports[topic], to_ns(message.header.stamp)) for topic, message in came],
        )

    def test_rate_is_nominal(self, pictures: Pictures) -> None:
        """Images arrive at the nominal rate. A lower rate means lost frames."""
        stamps = timed.stamps_of(pictures.outlines["left"])
        timed.check_rate(stamps, self.rate_hz, self.rate_tolerance)

    def test_stamps_increase_regularly(self, pictures: Pictures) -> None:
        """Each stamp is the time of that exposure, even if the image is sent late."""
        for arrivals in pictures.outlines.values():
            stamps = timed.stamps_of(arrivals)
            timed.check_increasing(stamps)
            timed.check_regular(stamps, self.jitter)

    def test_stamps_are_current(self, pictures: Pictures) -> None:
        """On arrival, stamps are neither too old nor in the future by the deployment's clock."""
        for arrivals in pictures.outlines.values():
            timed.check_present(arrivals, -self.early_s, self.oldest_s, self.early_s)

    def test_messages_of_a_pair_have_the_same_stamp(self, pictures: Pictures) -> None:
        """Subscribers match the images and camera infos of a pair by their stamp."""
        streams: dict[str, list[Any]] = {}
        for side in self.sides():
            streams[f"{side}_image"] = [one.message for one in pictures.outlines[side]]
            streams[f"{side}_info"] = [one.message for one in pictures.infos[side]]
        check_together(streams)

    def test_infos_precede_their_images(self, pictures: Pictures) -> None:
        """A camera info arrives before its image, so that a subscriber can rectify the image."""
        for side in self.sides():
            stamps = [stamp for port, stamp in pictures.order if port == f"{side}_image"]
            # Without those whose info arrived before the sample began.
            early = [
                stamp
                for stamp in stamps
                if (f"{side}_info", stamp) in pictures.order
                and pictures.order.index((f"{side}_info", stamp))
                > pictures.order.index((f"{side}_image", stamp))
            ]
            assert not early, (
                f"{len(early)} of {len(stamps)} {side} images arrived before their camera info; "
                "publish the camera info first"
            )

    def test_frame_ids_are_as_configured(self, pictures: Pictures) -> None:
        """Images and camera infos have the frames that tf uses."""
        for side in self.sides():
            frame = self.frames[side]
            check_frame((one.message.header.frame_id for one in pictures.outlines[side]), frame)
            check_frame((one.message.header.frame_id for one in pictures.infos[side]), frame)

    def test_images_are_complete(self, pictures: Pictures) -> None:
        """The encoding is known, and a row is long enough for its pixels."""
        for side in self.sides():
            check_image(pictures.whole[side])

    def test_image_sizes_equal_those_of_the_calibration(self, pictures: Pictures) -> None:
        """Each image has the size of its camera info, and both sides have the same size."""
        for side in self.sides():
            check_size(pictures.whole[side], pictures.infos[side][0].message, side)
        sizes = {(image.width, image.height) for image in pictures.whole.values()}
        assert len(sizes) == 1, f"left and right images have different sizes: {sorted(sizes)}"

    def test_calibration_fits_the_image_size(self, pictures: Pictures) -> None:
        """Focal lengths are positive, and the principal point is within the image [px]."""
        infos = {side: some[0].message for side, some in pictures.infos.items()}
        found = all(map(is_calibrated, infos.values()))
        if not self.calibrated:
            pytest.skip("the driver has no calibration")
        assert found, "k is 0: the driver does not publish its calibration"
        for side, info in infos.items():
            check_calibration(info, side)

    def test_baseline_is_positive(self, pictures: Pictures) -> None:
        """The right camera is to the right of the left one, by a plausible distance in meters."""
        if not (self.stereo and self.calibrated):
            pytest.skip("a single or uncalibrated camera has no baseline")
        left, right = (pictures.infos[side][0].message for side in self.sides())
        check_baseline(left, right)

    def test_images_are_not_frozen(self, pictures: Pictures) -> None:
        """Images differ. A camera that hangs repeats its last image."""
        if not self.moving:
            pytest.skip("images of this camera may be identical")
        for side, arrivals in pictures.outlines.items():
            check_not_frozen([one.message for one in arrivals], side)


class StereoCameraContract(DriverContract, PicturesContract):
    """All tests of a camera driver. Derive a class and set the attributes of your camera."""


def outline(image: Image) -> Image:
    """Return the image with a checksum instead of its pixels, to save memory.

    `data` is one row that holds the checksum; width, encoding and header are unchanged.
    """
    return replace(
        image,
        height=1,
        step=_CHECKSUM_BYTES,
        data=np.frombuffer(zlib.crc32(image.data.tobytes()).to_bytes(_CHECKSUM_BYTES), np.uint8),
    )


def check_image(image: Image) -> None:
    """Check that the encoding is known and that `step` is long enough for a row."""
    size = f"{image.width} x {image.height} pixels"
    assert min(image.width, image.height) > 0, f"an image is {size}"
    bytes_ = BYTES_PER_PIXEL.get(image.encoding)
    assert bytes_ is not None, (
        f"encoding {image.encoding!r} is unknown; known are {', '.join(BYTES_PER_PIXEL)}"
    )
    assert image.step >= image.width * bytes_, (
        f"step = {image.step} bytes, but a row of {image.width} pixels in {image.encoding} has "
        f"{image.width * bytes_}"
    )


def check_size(image: Image, info: CameraInfo, side: str) -> None:
    """Check that the image has the size of its camera info."""
    found, expected = (image.width, image.height), (info.width, info.height)
    hint = ": width and height are swapped" if found == expected[::-1] else ""
    assert found == expected, (
        f"the {side} image is {found[0]} x {found[1]} pixels, but its camera info has "
        f"{expected[0]} x {expected[1]}{hint}"
    )


def check_calibration(info: CameraInfo, side: str) -> None:
    """Check that focal lengths are positive and the principal point is in the image [px]."""
    fx, fy, cx, cy = info.k[0], info.k[4], info.k[2], info.k[5]
    assert min(fx, fy) > 0.0, f"the {side} camera has focal lengths of {fx:g} and {fy:g} px"
    is_inside = 0.0 < cx < info.width and 0.0 < cy < info.height
    assert is_inside, (
        f"the {side} camera's principal point is at {cx:g}, {cy:g} px, outside of the image"
    )


def check_baseline(left: CameraInfo, right: CameraInfo) -> None:
    """Check that the right camera is on the right, by `p`: Tx = -fx * baseline there, 0 left."""
    assert left.p[3] == 0.0, (
        f"p of the left camera has Tx = {left.p[3]:g}, not 0: are the sides swapped?"
    )
    baseline = -right.p[3] / right.p[0] if right.p[0] else math.nan
    assert 0.0 < baseline < _LONGEST_BASELINE_M, (
        f"by p the right camera is {baseline:g} m to the right of the left one (expected: 0 to "
        f"{_LONGEST_BASELINE_M:g} m); Tx is -fx * baseline, with the baseline in meters"
    )


def is_calibrated(info: CameraInfo) -> bool:
    """Return whether the camera info has a calibration; without one, `k` is 0."""
    return bool(info.k[0])


def check_together(streams: Mapping[str, Sequence[Image | CameraInfo]]) -> None:
    """Check that every stamp occurs in all streams, except at the edges of the sample."""
    stamps = {name: [to_ns(one.header.stamp) for one in some] for name, some in streams.items()}
    first = max(min(some) for some in stamps.values())
    last = min(max(some) for some in stamps.values())
    for name, some in stamps.items():
        within = {stamp for stamp in some if first <= stamp <= last}
        for other, others in stamps.items():
            alone = within - set(others)
            assert not alone, (
                f"{len(alone)} of {len(within)} messages on {name} have a stamp that no message on "
                f"{other} has, such as {min(alone)} ns; messages of a pair must have the same stamp"
            )


def check_not_frozen(images: Sequence[Image], side: str) -> None:
    """Check that images differ: a working camera takes no two identical images."""
    sums = {image.data.tobytes() for image in images}
    assert len(sums) > 1, f"all {len(images)} {side} images are identical"
