"""A camera has the requested rate, size, controls and name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from cairn import CairnError, ParameterRejected, to_ns
from cairn.components.v4l2_camera.probe_cli import describe_cameras, description_lines
from tests.components.v4l2_camera.driver import Driver
from tests.hardware.guest.camera import LEFT, RIGHT, SMALL, load_cameras, unload, value_of
from tests.wording import assert_words


@pytest.fixture(scope="module", autouse=True)
def _cameras() -> Iterator[None]:
    load_cameras()
    yield
    unload("vivid")


def test_all_messages_of_a_pair_have_one_stamp() -> None:
    with Driver(device=LEFT, right_device=RIGHT, **{**SMALL, "format": "YUYV"}) as driver:
        rights = [driver.await_one("right_image") for _ in range(5)]
        driver.request("deactivate")
        others = [driver.take(port) for port in ("left_image", "left_info", "right_info")]

    stamps = {to_ns(one.header.stamp) for one in rights}
    for messages in others:
        assert stamps <= {to_ns(one.header.stamp) for one in messages}


def test_controls_are_set_on_both_cameras_while_they_stream() -> None:
    with Driver(device=LEFT, right_device=RIGHT, **SMALL) as driver:
        driver.set(controls__brightness=77, controls__other={"hue": -9})
        driver.await_images(2)

        for camera in (LEFT, RIGHT):
            assert (value_of(camera, "brightness"), value_of(camera, "hue")) == (77, -9)


@pytest.mark.parametrize(
    ("changes", "report"),
    [
        ({"controls__brightness": 256}, "brightness = 256: the camera accepts 0 to 255"),
        ({"controls__auto_exposure": 1}, "the camera has no control auto_exposure; it has alpha"),
        ({"controls__other": {"test_pattern": 99}}, "accepts 0 (75% Colorbar), 1 (100% Colorbar)"),
        ({"controls__other": {"read_only_integer_32_bits": 1}}, "is read-only"),
        ({"width": 352}, "width cannot change while it runs"),
    ],
)
def test_invalid_value_is_rejected_with_its_bounds(changes: dict[str, object], report: str) -> None:
    with Driver(device=LEFT, **SMALL) as driver:
        before = value_of(LEFT, "brightness")

        with pytest.raises(ParameterRejected) as refused:
            driver.set(**changes)

        assert report in str(refused.value)
        assert value_of(LEFT, "brightness") == before


def test_differences_from_the_request_are_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with Driver(device=LEFT, format="GREY", width=600, height=400, rate=7) as driver:
        [image] = driver.await_images(1)

    assert (
        f"sends {image.width} x {image.height} pixels instead of the requested 600 x 400"
        in caplog.text
    )
    assert_words(caplog.text, "images per second", "requested 7")


@pytest.mark.parametrize(
    ("parameters", "report"),
    [
        ({"device": LEFT, "format": "MJPG"}, "but format is MJPG; choose another format"),
        ({"device": "name:absent"}, "name:absent: "),
        ({"device": "/dev/video63"}, "/dev/video63: "),
        ({"device": "/dev/null"}, "/dev/null"),
        ({"device": LEFT, "controls": {"gain": 999}}, "gain = 999: the camera accepts 0 to 255"),
    ],
)
def test_unusable_camera_is_rejected_when_it_is_configured(
    parameters: dict[str, Any], report: str
) -> None:
    with pytest.raises(CairnError) as refused:
        Driver(**parameters)

    assert report in str(refused.value)
    assert "camera: " in str(refused.value)


def test_cameras_are_listed_with_their_formats_and_controls() -> None:
    cameras = {camera["names"][-1]: camera for camera in describe_cameras()}

    for name in (LEFT, RIGHT):
        report = "\n".join(description_lines(cameras[name]))
        assert cameras[name]["error"] == ""
        assert "GREY: 320 x 180 at " in report
        assert re.search(r"brightness = \d+: 0 to 255; default 128", report)
        assert "not supported by this driver: UYVY" in report
