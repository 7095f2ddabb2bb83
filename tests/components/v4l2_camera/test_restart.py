"""A restarted driver waits for cameras that are away."""

from __future__ import annotations

import time

import pytest

from cairn import CairnError
from cairn.driver.diagnostics import ERROR
from tests.components.v4l2_camera.driver import Driver
from tests.components.v4l2_camera.fake_cameras import (
    HEIGHT,
    LEFT,
    ONE,
    RIGHT,
    TWO,
    WIDTH,
    FakeCamera,
    FakeCameras,
    level,
)
from tests.wording import words_in_order


@pytest.fixture
def left(cameras: FakeCameras) -> FakeCamera:
    camera = cameras.add(LEFT)
    camera.plugged = False
    return camera


def test_missing_camera_is_an_error_at_the_first_start(left: FakeCamera) -> None:
    with pytest.raises(CairnError, match=words_in_order("camera", "/dev/left", "no such camera")):
        Driver(**ONE)

    assert left.opened == 0


def test_restarted_driver_waits_for_a_missing_camera(left: FakeCamera) -> None:
    with Driver(restarts=1, **ONE) as driver:
        values = driver.await_values(lambda values: "no such camera" in values["message"])
        assert (values["level"], values["format"]) == (str(ERROR), "not negotiated yet")

        left.plug_in()
        left.send(5)
        image = driver.await_one("left_image")
        [info] = driver.take("left_info")
        values = driver.await_values(lambda values: values["level"] != str(ERROR))

    assert level(image) == 5
    assert (info.width, info.height, info.header) == (WIDTH, HEIGHT, image.header)
    assert (values["format"], values["negotiated rate [1/s]"]) == (f"GREY {WIDTH} x {HEIGHT}", "25")
    assert left.opened == 0


def test_restarted_driver_publishes_left_images_until_the_right_camera_is_there(
    cameras: FakeCameras, left: FakeCamera
) -> None:
    right = cameras.add(RIGHT)
    left.plugged, right.plugged = True, False
    with Driver(restarts=1, **TWO, rate=20) as driver:
        taken = time.monotonic_ns()  # of the pair; the others are too old to be paired with it
        left.send(3, captured=taken - 3_000_000_000)
        assert level(driver.await_one("left_image")) == 3

        right.plug_in()
        right.send(1, captured=taken - 2_000_000_000)  # before, left images are published alone
        driver.await_values(lambda values: values["images"] == "1", index=1)
        left.send(4, captured=taken)
        right.send(5, captured=taken + 19_000_000)  # of 25 images per second, not of 20
        assert level(driver.await_one("right_image")) == 5
        assert driver.values(2)["tolerance [ms]"] == "20"


def test_restarted_driver_rejects_cameras_of_different_sizes(
    cameras: FakeCameras, left: FakeCamera
) -> None:
    cameras.add(RIGHT)
    left.size = (32, 24)
    with Driver(restarts=1, **TWO) as driver:
        left.plug_in()
        values = driver.await_values(lambda values: "32 x 24 and 64 x 48" in values["message"])

    assert values["level"] == str(ERROR)
    assert left.opened == 0


def test_controls_can_be_changed_while_the_camera_is_away(left: FakeCamera) -> None:
    with Driver(restarts=1, **ONE, controls={"gain": 999}) as driver:
        left.plug_in()
        driver.await_values(
            lambda values: "gain = 999: the camera accepts 0 to 255" in values["message"]
        )

        driver.set(controls__gain=99)
        left.send(1)
        driver.await_one("left_image")

        assert left.values["gain"] == 99
