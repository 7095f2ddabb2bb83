"""The contract of a stereo camera: `left_image`, `right_image`, `left_info`, `right_info`.

A single camera has the left ports alone. docs/vision.md describes them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import pytest

from cairn.clock import to_ns
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.testing import pairs as judged
from cairn.testing import stamps as timed
from cairn.testing.bench import Bench
from cairn.testing.driver_contract import Contract, LifeCycleContract, ParametersContract
from cairn.testing.end_contract import EndContract, StopContract, UnplugContract
from cairn.testing.pauses import undisturbed
from cairn.testing.reading import Arrival, Reading
from cairn.testing.robot import Robot
from cairn.testing.scans import check_frame

_KINDS: Mapping[str, type[Any]] = {"image": Image, "info": CameraInfo}


@dataclass(frozen=True)
class Pictures:
    """A sample, by side: all images without pixels, the first whole, and what is told of them."""

    outlines: Mapping[str, list[Arrival[Image]]]
    whole: Mapping[str, Image]
    infos: Mapping[str, list[Arrival[CameraInfo]]]
    order: Sequence[tuple[str, int]]
    """Ports and stamps [ns] of all of them, in the order in which they came."""


class PicturesContract(Contract):
    """What images and calibrations say, and when."""

    component: ClassVar[str] = "camera"
    port: ClassVar[str] = "left_info"
    message: ClassVar[type[Any]] = CameraInfo

    stereo: ClassVar[bool] = True
    """False for a single camera, which has the left ports alone."""

    calibrated: ClassVar[bool] = True
    """False if the deployment gives the driver no calibration."""

    moving: ClassVar[bool] = True
    """False if images may be the same bit by bit, as those of a test picture."""

    rate_tolerance: ClassVar[float] = 0.1
    """How far the rate may be off the nominal one, as a share."""

    jitter: ClassVar[float] = 0.3
    """How far a spacing of stamps may be off the median, as a share."""

    oldest_s: ClassVar[float] = 0.5
    """How old an image may be when it comes [s]."""

    early_s: ClassVar[float] = 0.005
    """By how much a stamp may be in the future [s]."""

    frames: ClassVar[Mapping[str, str]] = {
        "left": "left_camera_optical_frame",
        "right": "right_camera_optical_frame",
    }
    """The frames of the cameras: x right, y down, z ahead (REP 103)."""

    sample_count: ClassVar[int] = 12
    """How many pairs are judged."""

    @classmethod
    def sides(cls) -> tuple[str, ...]:
        """The cameras that there are."""
        return ("left", "right") if cls.stereo else ("left",)

    @pytest.fixture(scope="class")
    @classmethod
    def pictures(cls, bench: Bench) -> Pictures:
        """Pairs in a row, that the tests of the class share."""
        robot = bench.robot(cls.component)
        return undisturbed(lambda: cls._taken(robot))

    @classmethod
    def _taken(cls, robot: Robot) -> Pictures:
        whole: dict[str, Image] = {}

        def keep(side: str, image: Image) -> Image:
            whole.setdefault(side, image)
            return judged.outline(image)

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
            with robot.order({topic: types[port] for topic, port in ports.items()}) as came:
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

    def test_rate(self, pictures: Pictures) -> None:
        """It is the nominal one: frames that are lost make it lower."""
        stamps = timed.stamps_of(pictures.outlines["left"])
        timed.check_rate(stamps, self.rate_hz, self.rate_tolerance)

    def test_stamps_increase_regularly(self, pictures: Pictures) -> None:
        """Each is of its own exposure: what is sent late was not seen late."""
        for arrivals in pictures.outlines.values():
            stamps = timed.stamps_of(arrivals)
            timed.check_increasing(stamps)
            timed.check_regular(stamps, self.jitter)

    def test_stamps_are_of_the_present(self, pictures: Pictures) -> None:
        """Neither of the future nor of long ago, by the deployment's clock."""
        for arrivals in pictures.outlines.values():
            timed.check_present(arrivals, -self.early_s, self.oldest_s, self.early_s)

    def test_messages_of_a_pair_have_one_stamp(self, pictures: Pictures) -> None:
        """By it they are found to belong together: both images and both calibrations."""
        streams: dict[str, list[Any]] = {}
        for side in self.sides():
            streams[f"{side}_image"] = [one.message for one in pictures.outlines[side]]
            streams[f"{side}_info"] = [one.message for one in pictures.infos[side]]
        judged.check_together(streams)

    def test_infos_come_before_their_images(self, pictures: Pictures) -> None:
        """So that whoever has an image knows how to rectify it."""
        for side in self.sides():
            told = [stamp for port, stamp in pictures.order if port == f"{side}_image"]
            # Without those whose info came before the sample began.
            early = [
                stamp
                for stamp in told
                if (f"{side}_info", stamp) in pictures.order
                and pictures.order.index((f"{side}_info", stamp))
                > pictures.order.index((f"{side}_image", stamp))
            ]
            assert not early, (
                f"{len(early)} of {len(told)} {side} images came before their camera info: it is "
                "published first"
            )

    def test_frames(self, pictures: Pictures) -> None:
        """Of images and camera infos, those that transforms know."""
        for side in self.sides():
            frame = self.frames[side]
            check_frame((one.message.header.frame_id for one in pictures.outlines[side]), frame)
            check_frame((one.message.header.frame_id for one in pictures.infos[side]), frame)

    def test_images_are_whole(self, pictures: Pictures) -> None:
        """Encoding, size and length of rows agree."""
        for side in self.sides():
            judged.check_image(pictures.whole[side])

    def test_sizes_are_those_of_the_calibration(self, pictures: Pictures) -> None:
        """Of each side, and both sides have the same."""
        for side in self.sides():
            judged.check_size(pictures.whole[side], pictures.infos[side][0].message, side)
        sizes = {(image.width, image.height) for image in pictures.whole.values()}
        assert len(sizes) == 1, f"left and right images have different sizes: {sorted(sizes)}"

    def test_calibration_is_of_such_a_camera(self, pictures: Pictures) -> None:
        """Lengths in pixels, the center within the image."""
        infos = {side: some[0].message for side, some in pictures.infos.items()}
        found = all(map(judged.is_calibrated, infos.values()))
        if not self.calibrated:
            pytest.skip("the driver is given no calibration")
        assert found, "k is 0: the driver tells no calibration, though it is given one"
        for side, info in infos.items():
            judged.check_calibration(info, side)

    def test_right_is_right(self, pictures: Pictures) -> None:
        """The baseline is positive and in meters; swapped cameras see everything behind them."""
        if not (self.stereo and self.calibrated):
            pytest.skip("a single camera, or one that is not calibrated, has no baseline")
        left, right = (pictures.infos[side][0].message for side in self.sides())
        judged.check_baseline(left, right)

    def test_images_are_not_frozen(self, pictures: Pictures) -> None:
        """A camera that hangs may send its last image for ever."""
        if not self.moving:
            pytest.skip("images of this camera may be the same")
        for side, arrivals in pictures.outlines.items():
            judged.check_not_frozen([one.message for one in arrivals], side)


class StereoCameraContract(
    EndContract,
    StopContract,
    UnplugContract,
    LifeCycleContract,
    ParametersContract,
    PicturesContract,
):
    """All that a driver of a camera keeps to; derive from it and say what is yours."""
