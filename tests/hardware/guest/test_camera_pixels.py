"""The driver publishes the pixels that were sent, and drops incomplete pictures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import simplejpeg
from numpy.typing import NDArray

from tests.components.v4l2_camera.driver import Driver
from tests.hardware.guest.camera import Loopback, load, unload

NAME = "cairn-test"
WIDTH, HEIGHT = 640, 480
Gray = NDArray[np.uint8]


@pytest.fixture(scope="module", autouse=True)
def _loopback() -> Iterator[None]:
    load("v4l2loopback", "video_nr=40", f"card_label={NAME}", "exclusive_caps=0", "max_buffers=4")
    yield
    unload("v4l2loopback")


def pictures(count: int) -> list[Gray]:
    random = np.random.default_rng(0)
    return [random.integers(0, 256, (HEIGHT, WIDTH), np.uint8) for _ in range(count)]


def yuyv(gray: Gray) -> bytes:
    both = np.empty((HEIGHT, WIDTH, 2), np.uint8)
    both[..., 0], both[..., 1] = gray, 255 - gray
    return both.tobytes()


def jpeg(gray: Gray) -> bytes:
    colors = np.dstack((gray, 255 - gray, gray[::-1]))
    data = simplejpeg.encode_jpeg(colors, quality=80, colorspace="RGB", colorsubsampling="422")
    return bytes(data)


def pixels(image: Any) -> Gray:
    assert image.encoding == "mono8"
    return np.asarray(image.data).reshape(image.height, image.width)


def driver(pixel_format: str, **more: Any) -> Driver:
    return Driver(device=f"name:{NAME}", format=pixel_format, width=WIDTH, height=HEIGHT, **more)


@pytest.fixture
def source(request: pytest.FixtureRequest) -> Iterator[Loopback]:
    source = Loopback(NAME, request.param, WIDTH, HEIGHT, 2 * WIDTH * HEIGHT)
    source.write(bytes(2 * WIDTH * HEIGHT) if request.param == "YUYV" else bytes(WIDTH * HEIGHT))
    yield source
    source.close()


def sent_and_received(source: Loopback, camera: Driver, sent: list[bytes]) -> list[Gray]:
    received = []
    camera.take("left_image")
    for data in sent:
        source.write(data)
        # The blank that the loopback was made with may come first, more than once.
        image = camera.await_one("left_image", lambda image: bool(pixels(image).any()))
        received.append(pixels(image))
    return received


@pytest.mark.parametrize("source", ["GREY"], indirect=True)
def test_gray_images_arrive_unchanged(source: Loopback) -> None:
    sent = pictures(5)
    with driver("GREY") as camera:
        received = sent_and_received(source, camera, [one.tobytes() for one in sent])

    assert [one.tolist() for one in received] == [one.tolist() for one in sent]


@pytest.mark.parametrize("source", ["YUYV"], indirect=True)
def test_yuyv_images_are_decoded_to_their_brightness(source: Loopback) -> None:
    sent = pictures(5)
    with driver("YUYV") as camera:
        received = sent_and_received(source, camera, [yuyv(one) for one in sent])

    assert [one.tolist() for one in received] == [one.tolist() for one in sent]


@pytest.mark.parametrize("source", ["MJPG"], indirect=True)
def test_mjpg_images_are_decoded_to_their_brightness(source: Loopback) -> None:
    sent = [jpeg(one) for one in pictures(5)]
    with driver("MJPG") as camera:
        received = sent_and_received(source, camera, sent)

    expected = [simplejpeg.decode_jpeg(one, colorspace="GRAY")[..., 0] for one in sent]
    assert [one.tolist() for one in received] == [one.tolist() for one in expected]


@pytest.mark.parametrize("source", ["GREY"], indirect=True)
def test_side_by_side_images_arrive_as_a_pair(source: Loopback) -> None:
    [sent] = pictures(1)
    with driver("GREY", side_by_side=True) as camera:
        left = sent_and_received(source, camera, [sent.tobytes()])[0]
        right = camera.await_one("right_image", lambda image: bool(pixels(image).any()))

    assert left.tolist() == sent[:, : WIDTH // 2].tolist()
    assert pixels(right).tolist() == sent[:, WIDTH // 2 :].tolist()


@pytest.mark.parametrize("source", ["MJPG"], indirect=True)
@pytest.mark.parametrize(
    ("damage", "counted"),
    [
        (lambda data: data[: len(data) // 2], "short"),
        (lambda data: data[: len(data) // 2] + b"\xff\xd9", "damaged"),
        (lambda data: b"\0" + data[1:], "damaged"),
        (lambda data: data[:2000] + bytes(2000) + data[4000:], "damaged"),
    ],
    ids=["truncated", "cut in the middle", "no beginning", "overwritten"],
)
def test_damaged_mjpg_is_dropped_and_counted(source: Loopback, damage: Any, counted: str) -> None:
    first, second = (jpeg(one) for one in pictures(2))
    with driver("MJPG") as camera:
        sent_and_received(source, camera, [first])
        before = int(camera.values()[counted])
        source.write(damage(first))
        camera.await_values(lambda values: int(values[counted]) == before + 1)
        [received] = sent_and_received(source, camera, [second])

    expected = simplejpeg.decode_jpeg(second, colorspace="GRAY")[..., 0]
    assert received.tolist() == expected.tolist()


@pytest.mark.parametrize("source", ["GREY"], indirect=True)
def test_short_picture_is_dropped_and_counted(source: Loopback) -> None:
    [whole] = pictures(1)
    with driver("GREY") as camera:
        sent_and_received(source, camera, [whole.tobytes()])
        before = int(camera.values()["short"])
        source.write(whole.tobytes()[:-WIDTH])
        camera.await_values(lambda values: int(values["short"]) == before + 1)
