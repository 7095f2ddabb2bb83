"""Two cameras of 640 x 480 pixels at 25 images per second lose no image."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.components.v4l2_camera.driver import Driver
from tests.hardware.guest.camera import LEFT, RIGHT, load_cameras, unload

_PICTURES = 150


@pytest.fixture(scope="module", autouse=True)
def _cameras() -> Iterator[None]:
    load_cameras()
    yield
    unload("vivid")


@pytest.mark.parametrize("pixel_format", ["GREY", "YUYV"])
def test_no_image_is_lost(pixel_format: str) -> None:
    with Driver(device=LEFT, right_device=RIGHT, format=pixel_format, rate=25) as driver:
        driver.await_one("right_image")
        driver.await_images(25)
        before = losses(driver)
        driver.await_images(_PICTURES)
        assert losses(driver) == before


def losses(driver: Driver) -> dict[str, list[int]]:
    """Pictures lost and dropped so far, of the left and of the right camera."""
    report = [driver.values(index) for index in range(2)]
    return {name: [int(one[name]) for one in report] for name in ("lost", "dropped")}
