"""After each fault of a camera, its driver reports the fault and publishes images again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from cairn.components.v4l2_camera.pairing import UNPAIRED_KEPT
from cairn.driver.diagnostics import ERROR
from tests.components.v4l2_camera.driver import Driver
from tests.hardware.guest.camera import (
    LEFT,
    RIGHT,
    SMALL,
    Knobs,
    disconnected,
    load_cameras,
    plug_in_cameras,
    unload,
    unplug_cameras,
    value_of,
)


@pytest.fixture(scope="module", autouse=True)
def _cameras() -> Iterator[None]:
    load_cameras()
    yield
    unload("vivid")


@pytest.fixture
def driver() -> Iterator[Driver]:
    """A driver for which no pause of the emulated machine is a silent camera."""
    with Driver(device=LEFT, **SMALL, silence_s=60.0) as driver:
        driver.await_images(2)
        yield driver


def test_damaged_buffer_is_dropped_and_counted(driver: Driver) -> None:
    Knobs(LEFT).turn("inject_v4l2_buf_flag_error")

    values = driver.await_values(lambda values: values["marked"] == "1")

    assert values["restarts"] == "0"
    driver.await_images(3)


def test_failed_stream_is_restarted(driver: Driver) -> None:
    Knobs(LEFT).turn("inject_fatal_streaming_error")

    values = driver.await_values(lambda values: values["restarts"] == "1")

    assert values["reopened"] == "0"
    driver.await_images(3)


def test_rejected_buffer_restarts_the_stream(driver: Driver) -> None:
    Knobs(LEFT).turn("inject_vidioc_qbuf_error")

    driver.await_values(lambda values: values["restarts"] == "1")

    driver.await_images(3)


@pytest.mark.parametrize("request_", ["reqbufs", "streamon"])
def test_stream_that_does_not_start_is_started_again(request_: str) -> None:
    with Driver(device=LEFT, **SMALL) as driver:
        driver.await_images(1)
        driver.request("deactivate")
        Knobs(LEFT).turn(f"inject_vidioc_{request_}_error")
        driver.request("activate")
        driver.await_images(3)


def test_silent_stream_is_restarted() -> None:
    with Driver(device=LEFT, **SMALL, silence_s=0.5) as driver:
        driver.await_images(2)
        Knobs(LEFT).turn("percentage_of_dropped_buffers", 100)
        try:
            before = int(driver.values()["restarts"])
            values = driver.await_values(lambda values: int(values["restarts"]) > before + 1)
            assert values["level"] == str(ERROR)
        finally:
            Knobs(LEFT).turn("percentage_of_dropped_buffers", 0)

        driver.await_images(3)


def test_lost_frames_are_counted(driver: Driver) -> None:
    Knobs(LEFT).turn("percentage_of_dropped_buffers", 30)
    try:
        driver.await_values(lambda values: int(values["lost"]) > 2)
    finally:
        Knobs(LEFT).turn("percentage_of_dropped_buffers", 0)


def test_wrap_of_sequence_numbers_does_not_count_as_loss() -> None:
    Knobs(LEFT).turn("wrap_sequence_number", 1)
    try:
        with Driver(device=LEFT, **{**SMALL, "rate": 50}) as driver:
            driver.await_images(150)  # numbers begin 128 before they wrap
            values = driver.values()
    finally:
        Knobs(LEFT).turn("wrap_sequence_number", 0)

    assert int(values["lost"]) < 2**16, "of 2**32 numbers"


def test_impossible_time_is_replaced_by_the_time_of_arrival() -> None:
    Knobs(LEFT).turn("wrap_timestamp", 1)
    try:
        with Driver(device=LEFT, **SMALL) as driver:
            [image] = driver.await_images(1)
            values = driver.values()
            now = time.time()
    finally:
        Knobs(LEFT).turn("wrap_timestamp", 0)

    assert now - 5 < image.header.stamp.sec <= now
    assert int(values["unstamped"]) > 0


def test_stamps_at_the_start_of_exposure_are_reported() -> None:
    Knobs(LEFT).turn("timestamp_source", 1)
    try:
        with Driver(device=LEFT, **SMALL) as driver:
            driver.await_images(1)
            assert driver.values()["stamped at"] == "start of exposure"
    finally:
        Knobs(LEFT).turn("timestamp_source", 0)


def test_camera_that_disappears_for_a_moment_is_reopened(driver: Driver) -> None:
    Knobs(LEFT).turn("disconnect")  # vivid's cameras return when no process has them open

    driver.await_values(lambda values: values["reopened"] == "1")

    driver.await_images(3)


def test_unplugged_cameras_are_reopened_with_their_settings_when_they_return(
    record_property: Callable[[str, object], None],
) -> None:
    with Driver(device=LEFT, right_device=RIGHT, **SMALL) as driver:
        driver.await_one("right_image")
        driver.set(controls__gain_automatic=0, controls__gain=33)

        unplug_cameras()
        values = driver.await_values(lambda values: "no such camera" in values["message"])
        assert values["level"] == str(ERROR)
        driver.set(controls__gain=44)
        driver.take("right_image")
        plug_in_cameras()
        back = time.monotonic()
        driver.await_one("right_image")
        record_property("published again after [s]", round(time.monotonic() - back, 2))

        assert driver.values()["reopened"] == "1"
        assert {value_of(camera, "gain") for camera in (LEFT, RIGHT)} == {44}


def test_left_images_are_published_while_the_right_camera_is_away() -> None:
    with Driver(device=LEFT, right_device=RIGHT, **SMALL) as driver:
        driver.await_one("right_image")

        with disconnected(RIGHT):
            driver.await_values(
                lambda values: (
                    values["level"] == str(ERROR)
                    and (
                        "disappeared" in values["message"] or "no such camera" in values["message"]
                    )
                ),
                index=1,
            )
            # Right images that came before may still get their left ones.
            driver.await_images(UNPAIRED_KEPT + 2)
            driver.take("right_image")
            driver.await_images(5)
            assert driver.take("right_image") == []

        driver.await_one("right_image")
