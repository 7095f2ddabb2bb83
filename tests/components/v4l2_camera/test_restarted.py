"""A driver that is started again, after it worked before, waits for cameras that are away."""

from __future__ import annotations

import time

import pytest

from cairn import CairnError
from cairn.driver.diagnostics import ERROR
from tests.components.v4l2_camera.driving import Driver, RestartedDriver
from tests.components.v4l2_camera.fakes import (
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


@pytest.fixture
def left(cameras: FakeCameras) -> FakeCamera:
    camera = cameras.add(LEFT)
    camera.plugged = False
    return camera


def test_at_the_first_start_a_camera_that_is_away_is_a_mistake(left: FakeCamera) -> None:
    with pytest.raises(CairnError, match="camera: /dev/left: there is no such camera"):
        Driver(**ONE)

    assert left.opened == 0


def test_after_a_restart_a_camera_that_is_away_is_told_of_and_waited_for(left: FakeCamera) -> None:
    with RestartedDriver(**ONE) as driver:
        told = driver.await_values(lambda told: "no such camera" in told["message"])
        assert (told["level"], told["format"]) == (str(ERROR), "not agreed on yet")

        left.plug_in()
        left.send(5)
        image = driver.await_one("left_image")
        [info] = driver.taken("left_info")
        told = driver.await_values(lambda told: told["level"] != str(ERROR))

    assert level(image) == 5
    assert (info.width, info.height, info.header) == (WIDTH, HEIGHT, image.header)
    assert (told["format"], told["rate agreed on [1/s]"]) == (f"GREY {WIDTH} x {HEIGHT}", "25")
    assert left.opened == 0


def test_after_a_restart_the_left_camera_is_published_alone_until_the_right_one_is_there(
    cameras: FakeCameras, left: FakeCamera
) -> None:
    right = cameras.add(RIGHT)
    left.plugged, right.plugged = True, False
    with RestartedDriver(**TWO, rate=20) as driver:
        left.send(3)
        assert level(driver.await_one("left_image")) == 3

        right.plug_in()
        taken = time.monotonic_ns()
        left.send(4, taken=taken)
        right.send(5, taken=taken + 19_000_000)  # of 25 pictures a second, not of 20
        assert level(driver.await_one("right_image")) == 5
        assert driver.values(2)["paired within [ms]"] == "20"


def test_after_a_restart_a_camera_of_another_size_than_its_other_is_refused(
    cameras: FakeCameras, left: FakeCamera
) -> None:
    cameras.add(RIGHT)
    left.size = (32, 24)
    with RestartedDriver(**TWO) as driver:
        left.plug_in()
        told = driver.await_values(lambda told: "32 x 24 and 64 x 48" in told["message"])

    assert told["level"] == str(ERROR)
    assert left.opened == 0


def test_controls_may_be_changed_before_the_camera_is_there(left: FakeCamera) -> None:
    with RestartedDriver(**ONE, controls={"gain": 999}) as driver:
        left.plug_in()
        driver.await_values(lambda told: "gain = 999: the camera takes 0 to 255" in told["message"])

        driver.set(controls__gain=99)
        left.send(1)
        driver.await_one("left_image")

        assert left.values["gain"] == 99
