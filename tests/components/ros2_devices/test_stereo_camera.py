"""The driver of a stereo camera behind ROS 2 in virtual time."""

from typing import Any

import cv2
import numpy as np
import pytest

from cairn import SECOND, from_ns, to_ns
from cairn.components.ros2_devices.stereo_camera import Ros2StereoCamera
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.sensor_msgs.msg import CompressedImage
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from cairn.vision.images import gray_of

GRAY = np.arange(32 * 24, dtype=np.uint8).reshape(24, 32)


class Camera(ComponentHarness[Ros2StereoCamera]):
    """The driver, and nodes that publish images."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__(Ros2StereoCamera, parameters, start_s=10.0)

    def header(self, age_s: float = 0.0) -> Header:
        return Header(stamp=from_ns(self.now_ns - round(age_s * SECOND)), frame_id="camera")

    def photograph(self, age_s: float = 0.0, encoding: str = "rgb8") -> Image:
        data = np.repeat(GRAY.reshape(-1), 3)
        return Image(
            header=self.header(age_s), height=24, width=32, encoding=encoding, step=96, data=data
        )

    def stamps(self, port: str) -> list[int]:
        return [to_ns(image.header.stamp) for image in self.take(port)]

    def health(self) -> list[tuple[int, str]]:
        return [(one.level, one.message) for one in self.take("diagnostics")[-1].status]


def test_images_of_a_pair_get_one_stamp_whichever_comes_first() -> None:
    camera = Camera()
    for first, second in (("left", "right"), ("right", "left")):
        camera.publish(f"source_{first}_image", camera.photograph(age_s=0.02))
        camera.publish(f"source_{second}_image", camera.photograph(age_s=0.015))
        camera.run_for(0.1)
    camera.publish("source_left_image", camera.photograph())  # its right one is lost
    camera.run_for(0.1)
    camera.publish("source_right_image", camera.photograph())

    left, right = camera.take("left_image"), camera.stamps("right_image")
    assert [to_ns(image.header.stamp) for image in left][:2] == right[:2]
    assert (len(left), len(right), len({to_ns(one.header.stamp) for one in left} & {*right})) == (
        3, 3, 2,
    )  # fmt: skip
    assert {image.encoding for image in left} == {"mono8"}
    assert np.array_equal(gray_of(left[0]), GRAY)
    assert left[0].header.frame_id == "left_camera_optical_frame"


def test_pair_that_is_stamped_on_arrival_has_one_stamp() -> None:
    camera = Camera(stamp_on_arrival=True)
    left, right = camera.photograph(age_s=9.0), camera.photograph(age_s=9.0)
    camera.publish("source_left_image", left)
    began = camera.now_ns
    camera.run_for(0.03)
    camera.publish("source_right_image", right)

    assert camera.stamps("left_image") == camera.stamps("right_image") == [began]


def test_compressed_images_are_decoded() -> None:
    camera = Camera(compressed=True, stereo=False)
    png = cv2.imencode(".png", GRAY)[1].reshape(-1)

    camera.publish(
        "source_left_compressed",
        CompressedImage(header=camera.header(), format="mono8; png compressed", data=png),
    )
    camera.publish("source_left_image", camera.photograph())

    (image,) = camera.take("left_image")
    assert np.array_equal(gray_of(image), GRAY)


@pytest.mark.parametrize(
    ("compressed", "reason"),
    [
        (False, "left_image: an image of camera: encoding = '32FC1' is not supported; set its "),
        (True, "left_compressed: an image of format 'jpeg'"),
    ],
)
def test_image_that_cannot_be_decoded_is_reported(compressed: bool, reason: str) -> None:
    camera = Camera(compressed=compressed)
    for _ in range(12):
        camera.publish("source_left_image", camera.photograph(encoding="32FC1"))
        camera.publish(
            "source_left_compressed",
            CompressedImage(header=camera.header(), format="jpeg", data=np.zeros(9, np.uint8)),
        )
        camera.run_for(0.1)

    (level, message), right = camera.health()
    assert (level, reason in message) == (2, True), message
    assert right[0] == 2
    assert "the right camera's image does not arrive on /robot/source_right" in right[1]


def test_right_camera_is_mounted_beside_the_left_one_once_both_are_calibrated() -> None:
    camera = Camera()
    for side, shift in (("left", 0.0), ("right", -40.0)):
        camera.publish(
            f"source_{side}_info",
            CameraInfo(
                header=camera.header(), width=640, height=480, distortion_model="plumb_bob",
                d=np.zeros(5), k=np.array([400, 0, 320, 0, 400, 240, 0, 0, 1.0]),
                r=np.eye(3).ravel(),
                p=np.array([400, 0, 320, shift, 0, 400, 240, 0, 0, 0, 1.0, 0]),
            ),
        )  # fmt: skip

    (info,) = camera.take("right_info")
    assert info.header.frame_id == "right_camera_optical_frame"
    transforms = camera.take("tf_static")[-1].transforms
    assert transforms[1].transform.translation.y == pytest.approx(-0.1)
