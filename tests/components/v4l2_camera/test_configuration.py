"""Parameters, calibrations and formats: what is rejected before a camera streams."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cairn import CairnError
from cairn.components.v4l2_camera.config import ControlsConfig, V4l2StereoCameraConfig
from cairn.components.v4l2_camera.format_negotiation import FrameSize, best_format
from cairn.driver.device_names import devices_named
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.vision.camera_file import write_camera
from tests.components.v4l2_camera.driver import Driver
from tests.components.v4l2_camera.fake_cameras import HEIGHT, WIDTH, FakeCameras
from tests.wording import assert_words, words_in_order

LEFT, RIGHT = "/dev/left", "/dev/right"
BASELINE_M = 0.12
VGA = (640, 480)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"device": "video0"}, "device = 'video0' does not name a camera; use path, name:NAME"),
        ({"device": LEFT, "right_device": "x"}, "right_device = 'x' does not name a camera"),
        ({"device": LEFT, "right_device": LEFT}, "are both '/dev/left'"),
        ({"device": LEFT, "right_device": RIGHT, "side_by_side": True}, "leave right_device out"),
        ({"device": LEFT, "side_by_side": True, "width": 641}, "width = 641 is odd"),
        ({"device": LEFT, "right_comes_first": True}, "is for side_by_side cameras"),
        ({"device": LEFT, "right_calibration": "r.yaml"}, "there is no right camera"),
        ({"device": LEFT, "format": "H264"}, "Input should be 'auto', 'GREY', 'YUYV' or 'MJPG'"),
        ({"device": LEFT, "controls": {"gian": 1}}, "Extra inputs are not permitted"),
    ],
)
def test_inconsistent_parameters_are_rejected(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError) as refused:
        V4l2StereoCameraConfig.model_validate(parameters)

    assert message in str(refused.value)


def test_controls_are_returned_by_name() -> None:
    controls = ControlsConfig(gain=3, auto_exposure=0, other={"led1_mode": 1})

    assert controls.values() == {"gain": 3, "auto_exposure": 0, "led1_mode": 1}


def test_devices_of_a_deployment_are_found() -> None:
    config = V4l2StereoCameraConfig(device=LEFT, right_device=RIGHT)

    found = {named.parameter: named.find() for named in devices_named(config)}

    assert found == {"device": LEFT, "right_device": RIGHT}


@pytest.mark.parametrize(
    ("offers", "rate", "chosen"),
    [
        ({"MJPG": [FrameSize(640, 480, (30.0,))], "YUYV": [FrameSize(640, 480, (30.0,))]}, 25,
         "YUYV"),
        ({"MJPG": [FrameSize(640, 480, (60.0,))], "YUYV": [FrameSize(640, 480, (30.0,))]}, 60,
         "MJPG"),
        ({"MJPG": [FrameSize(640, 480, (30.0,))], "YUYV": [FrameSize(320, 240, (30.0,))]}, 30,
         "MJPG"),
        ({"YUYV": [FrameSize(640, 480, (29.97,))], "MJPG": []}, 30, "YUYV"),
        ({"YUYV": [FrameSize(1920, 1080, (), is_range=True)]}, 30, "YUYV"),
        ({"YUYV": []}, 30, "YUYV"),
        ({"MJPG": [FrameSize(320, 240, (30.0,))], "YUYV": [FrameSize(320, 240, ())]}, 30,
         "YUYV"),  # none suits: the camera gives what comes nearest
        ({}, 30, None),
    ],
)  # fmt: skip
def test_first_format_with_the_size_at_the_rate_is_chosen(
    offers: dict[str, list[FrameSize]], rate: float, chosen: str | None
) -> None:
    assert best_format(offers, ("GREY", "YUYV", "MJPG"), VGA, rate) == chosen


@pytest.fixture
def stereo(cameras: FakeCameras, tmp_path: Path) -> dict[str, Any]:
    """Two cameras, and calibrations of their size."""
    for path in (LEFT, RIGHT):
        cameras.add(path)
    parameters: dict[str, Any] = {
        "device": LEFT, "right_device": RIGHT, "width": WIDTH, "height": HEIGHT, "format": "GREY"
    }  # fmt: skip
    for side, right in (("left", 0.0), ("right", BASELINE_M)):
        k = np.array([150.0, 0, 80, 0, 150, 60, 0, 0, 1])
        p = np.array([150.0, 0, 80, -150 * right, 0, 150, 60, 0, 0, 0, 1, 0])
        info = CameraInfo(
            width=160, height=120, distortion_model="plumb_bob", d=np.zeros(5), k=k,
            r=np.eye(3).ravel(), p=p,
        )  # fmt: skip
        write_camera(tmp_path / f"{side}.yaml", info, side)
        parameters[f"{side}_calibration"] = str(tmp_path / f"{side}.yaml")
    for camera in cameras.cameras.values():
        camera.size = (160, 120)
    return parameters


def test_calibrations_determine_the_pose_of_the_right_camera(stereo: dict[str, Any]) -> None:
    with Driver(**stereo, mount_frame="head") as driver:
        [message] = driver.take("tf_static")

    left, right = message.transforms
    assert (left.header.frame_id, right.header.frame_id) == ("head", "head")
    assert left.transform.translation.y == 0.0
    assert right.transform.translation.y == pytest.approx(-BASELINE_M)
    assert left.child_frame_id == "left_camera_optical_frame"


def test_calibration_of_another_size_is_rejected(
    stereo: dict[str, Any], cameras: FakeCameras
) -> None:
    for camera in cameras.cameras.values():
        camera.size = (WIDTH, HEIGHT)

    with pytest.raises(CairnError, match=f"but the camera sends {WIDTH} x {HEIGHT}; calibrate"):
        Driver(**stereo)

    assert all(camera.opened == 0 for camera in cameras.cameras.values())


def test_late_cameras_must_fit_their_calibrations(
    stereo: dict[str, Any], cameras: FakeCameras
) -> None:
    both = list(cameras.cameras.values())
    for camera in both:
        camera.plugged = False
        camera.size = (WIDTH, HEIGHT)
    with Driver(restarts=1, **stereo) as driver:
        for camera in both:
            camera.plug_in()
        driver.await_values(lambda values: "but the camera sends 64 x 48" in values["message"])
        for camera in both:
            camera.size = (160, 120)
        both[1].send(1)  # until it streams, left images are published alone
        driver.await_values(lambda values: values["images"] == "1", index=1)
        taken = time.monotonic_ns()
        for camera in both:
            camera.send(2, captured=taken)
        info = driver.await_one("right_info")

    assert info.p[3] == pytest.approx(-150 * BASELINE_M)


def test_differences_from_the_request_are_logged(
    stereo: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    with Driver(**stereo, rate=20):
        pass

    assert_words(caplog.text, "pixels", "requested 64 x 48")
    assert_words(caplog.text, "/dev/left", "25 images per second", "requested 20")


def test_cameras_of_different_sizes_are_rejected(cameras: FakeCameras) -> None:
    cameras.add(LEFT)
    cameras.add(RIGHT).size = (32, 24)

    with pytest.raises(CairnError, match=words_in_order("32 x 24", "64 x 48")):
        Driver(device=LEFT, right_device=RIGHT, width=WIDTH, height=HEIGHT)
